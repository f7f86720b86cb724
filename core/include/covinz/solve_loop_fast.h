// From the keyframes around a place-recognition candidate to a loop closure or the reason why not,
// the fast way: joint estimation over all matches, refinement of rigs that are not rigid, a choice
// among several solutions, and a covariance that knows the noise.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "covinz/rig_covariance.h"
#include "covinz/rig_hypotheses.h"
#include "covinz/rig_refinement.h"
#include "covinz/rig_selection.h"
#include "covinz/solve_loop.h"
#include "covinz/triangulation.h"

namespace covinz {

// Keyframes of one session; the first one is the reference.
struct LoopRig {
  std::vector<RigCamera> cameras;
  // What odometry says about the motions between them; must tie every camera to the first.
  std::vector<RigMotion> motions;
  // How each camera moved while it took its image; none where images are of their stamps' moments.
  std::vector<CameraExposure> exposures;
};

// Options of SolveLoopFast.
struct FastLoopOptions {
  MatchingOptions matching;
  RigHypothesisOptions hypotheses;
  RigRefinementOptions refinement;
  TrackDepthOptions depth;
  RigSelectionOptions selection;
  RefinementCovarianceOptions covariance;
  // Hypotheses that are refined: the best so many ...
  int max_num_refined = 5;
  // ... that have this part of the inliers of the best one at least: a second solution that could
  // be taken for the best shares more than 90 % of its inliers. [real images research]
  double min_inlier_share = 0.5;
  // Tracks and iterations of their first refinement, which only has to rank them: they are judged
  // on all matches. [24 unknowns; a full refinement mostly takes 5 iterations]
  int max_num_trial_tracks = 120;
  int max_num_trial_iterations = 4;
  // The best one, and those that it is not clearly ahead of, are then refined to the end ...
  // ... over the matches that they explain, chosen anew at most so often.
  int max_num_rounds = 8;
  // Matches that the solution must explain in all; there is no least number a pair. [paper III-B2]
  int min_num_inliers = 100;
  // Two cameras of one rig must be further apart than this [m], or there is no scale.
  double min_baseline_m = 0.01;
  // Nor is there one where odometry cannot tell the longest motion within a rig from none: its
  // length in standard deviations. [chi^2 with three degrees of freedom at 99.9 %: 4.03^2]
  double min_baseline_sigmas = 4.0;
  // Least probability that odometry is as wrong as the loop would have it: of right loops one in a
  // hundred may be lost. [motion_tail.h; decision 0025]
  double min_motion_probability = 0.01;
  // Largest predicted standard deviation of the translation [m], the root of its covariance's
  // trace. [catches what is left of loops without scale: short baselines, forward motion]
  double max_sigma_translation_m = 0.3;
  // Largest translation [m] and rotation [rad] between the reference keyframes. Off by default.
  double max_translation_m = std::numeric_limits<double>::infinity();
  double max_rotation_rad = std::numeric_limits<double>::infinity();
  // Of all kernels, in place of those of the stages. Results differ by rounding at most.
  InstructionSet instruction_set = BestInstructionSet();
  // Same seed and input, same result.
  uint64_t seed = 0;

  void Check() const;  // throws std::invalid_argument
};

// Relative pose of the reference keyframes of two rigs. Stops at the first stage that fails; the
// stages are those of LoopRejection. In LoopEstimate, num_inliers and num_pair_inliers are matches
// that the refined rigs explain, and num_iterations those of the last refinement.
//
// Throws std::invalid_argument for an empty rig, malformed cameras or motions, or bad options.
//
// Source: decisions 0019 (hypotheses) and 0020 (refinement, selection, covariance).
LoopResult SolveLoopFast(const LoopRig& query, const LoopRig& cand, const FastLoopOptions& options);

}  // namespace covinz
