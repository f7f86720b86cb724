// Which of several refined solutions explains the matches best, and whether it does so clearly.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "covinz/rig_refinement.h"
#include "covinz/rig_relative_pose.h"

namespace covinz {

// Options of ScoreSolution and CompareSolutions.
struct RigSelectionOptions {
  // Standard deviation of a match's Sampson error [px], and the error from which on matches count
  // as outliers [standard deviations].
  double sigma_px = 1.0;
  double max_error_sigmas = 3.0;
  // Matches whose rays point into one cell of the query's surroundings count as one witness [rad].
  double cell_rad = 0.2;
  // A solution is distinct from the best one when it is further away than this [m] or turned by
  // more [rad]. [what a map would bend by; 3 degrees]
  double min_distinct_m = 0.25;
  double min_distinct_rad = 0.052;
  // The best solution wins against a distinct one with this significance at least: standard
  // deviations, one error in a thousand if normal.
  double min_significance = 3.0;
  // However unanimous the witnesses: a likelihood ratio of 1000 is asked for.
  double min_log_likelihood_ratio = 7.0;
  // A solution that ends at the best one when refined over the inliers of both is in one valley
  // with it if it is within so many standard deviations of the best one's own covariance; else it
  // remains a rival. [chi-square, 6 degrees of freedom, 99.9 %]
  double max_valley_sigmas = 4.74;

  void Check() const;  // throws std::invalid_argument
};

// A refined solution as the matches see it.
struct SolutionScore {
  // For each match of all pairs in order: Sampson error / sigma, squared and truncated.
  std::vector<double> losses;
  double motion_cost;  // of odometry's residuals
  double cost;         // sum of both: -2 log likelihood
  // For each of rigs.pairs, ascending: matches within 3 px (max_error_sigmas sigma_px) and in
  // front.
  std::vector<std::vector<int>> inliers;
  int num_inliers;
};

// All solutions are judged on the same raw matches of all pairs, with the camera poses that the
// refinement gave them.
SolutionScore ScoreSolution(const RigPairs& rigs,
                            const RigRefinement& solution,
                            const RigRefinementOptions& refinement_options,
                            const RigSelectionOptions& options);

// Two refinements that ended, or are about to end, in one optimum: within a tenth of what makes
// solutions distinct.
bool AreEqual(const Eigen::Isometry3d& T_a,
              const Eigen::Isometry3d& T_b,
              const RigSelectionOptions& options);

bool AreDistinct(const Eigen::Isometry3d& T_a,
                 const Eigen::Isometry3d& T_b,
                 const RigSelectionOptions& options);

// How many standard deviations the best solution is ahead of another: the log-likelihood ratio over
// its own standard deviation. Each cell of the scene votes with its share of the ratio, since
// matches of one cell err alike; the votes against the majority show the noise, and no cell decides
// alone: sigma^2 = 2 sum_against d_c^2 + max_c d_c^2. (The plain scatter of the votes would count
// as noise that some parts of a scene tell much more than others.) Wrong loops are second solutions
// that trade translation for rotation about the scene's depth: a part of the scene prefers the one,
// a part the other, and the inlier counts hardly differ.
//
// Source: Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses",
// Econometrica 1989, with clusters as in Liang and Zeger, Biometrika 1986; decision 0020.
double Significance(const RigPairs& rigs,
                    const SolutionScore& best,
                    const SolutionScore& other,
                    const RigSelectionOptions& options);

}  // namespace covinz
