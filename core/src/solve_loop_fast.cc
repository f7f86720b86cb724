// Matching, hypotheses, refinement, selection, covariance: the fast profile as one pipeline.
#include "covinz/solve_loop_fast.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <utility>

#include <Eigen/Cholesky>

#include "covinz/motion_tail.h"
#include "matched_rigs.h"
#include "rig_adjustment.h"
#include "rig_choice.h"
#include "rig_solution.h"
#include "stage_clock.h"

namespace covinz {
namespace {

RefinedRig RigOf(const LoopRig& rig) {
  RefinedRig result;
  for (const RigCamera& camera : rig.cameras) {
    result.T_rig_cam.push_back(camera.T_rig_cam);
    result.focal_px.push_back(camera.focal_px);
  }
  result.motions = rig.motions;
  result.exposures = rig.exposures;
  result.Check();
  result.motions = MotionsBetweenImages(result);
  return result;
}

// Of the poses at the stamps; the refinement is of the images.
RefinementCovariance CovarianceOf(const LoopProblem& problem,
                                  const RigSolution& solution,
                                  const FastLoopOptions& options) {
  RefinementCovariance found =
      EstimateRefinementCovariance(problem.cand, problem.query, solution.tracks,
                                   solution.refinement, options.refinement, options.covariance);
  found.covariance +=
      StampCovariance(problem.cand, problem.query, solution.refinement.T_cand_query);
  return found;
}

LoopSolution Report(const LoopProblem& problem,
                    const RigSolution& solution,
                    const FastLoopOptions& options) {
  return {solution.refinement.T_cand_query, CovarianceOf(problem, solution, options).covariance,
          solution.score.num_inliers, solution.score.cost};
}

// Whether a distinct solution is nearly as good.
std::optional<LoopRejection> CheckUnambiguous(const LoopProblem& problem,
                                              const std::vector<RigSolution>& contenders,
                                              const FastLoopOptions& options) {
  const std::optional<Rival> rival = FindRival(problem, contenders, options);
  if (!rival) return std::nullopt;
  LoopRejection rejection{"ambiguous", std::nullopt, rival->significance,
                          options.selection.min_significance};
  rejection.solutions = {Report(problem, contenders[0], options),
                         Report(problem, contenders[rival->contender], options)};
  return rejection;
}

// Whether odometry can be as wrong as the solution needs it to be.
std::optional<LoopRejection> CheckMotions(const RigSolution& solution,
                                          const FastLoopOptions& options) {
  std::vector<double> costs;
  for (const Vector6d& residual : solution.refinement.motion_residuals) {
    costs.push_back(MotionLoss(residual.squaredNorm(), options.refinement).cost);
  }
  const double probability = MotionProbability(costs, options.refinement.motion_dof);
  if (probability >= options.min_motion_probability) return std::nullopt;
  return LoopRejection{"motions", std::nullopt, probability, options.min_motion_probability};
}

std::optional<LoopRejection> CheckPlausible(const LoopEstimate& loop,
                                            const FastLoopOptions& options) {
  const double sigma_m = std::sqrt(loop.covariance.bottomRightCorner<3, 3>().trace());
  if (!(sigma_m <= options.max_sigma_translation_m)) {
    return LoopRejection{"uncertainty", std::nullopt, sigma_m, options.max_sigma_translation_m};
  }
  const Vector6d xi = LogSE3(loop.T_cand_query);
  if (xi.tail<3>().norm() > options.max_translation_m) {
    return LoopRejection{"translation", std::nullopt, xi.tail<3>().norm(),
                         options.max_translation_m};
  }
  if (xi.head<3>().norm() > options.max_rotation_rad) {
    return LoopRejection{"rotation", std::nullopt, xi.head<3>().norm(), options.max_rotation_rad};
  }
  return std::nullopt;
}

LoopEstimate MakeEstimate(const LoopProblem& problem,
                          const RigSolution& solution,
                          const FastLoopOptions& options) {
  const RefinementCovariance covariance = CovarianceOf(problem, solution, options);
  LoopEstimate loop{
      solution.refinement.T_cand_query,  covariance.covariance, solution.score.num_inliers, {}, {},
      solution.refinement.num_iterations};
  for (size_t p = 0; p < problem.matched.rigs.pairs.size(); ++p) {
    loop.num_matches.push_back(static_cast<int>(problem.matched.rigs.pairs[p].size()));
    loop.num_pair_inliers.push_back(static_cast<int>(solution.score.inliers[p].size()));
  }
  loop.motion_residuals = solution.refinement.motion_residuals;
  loop.independent_px = covariance.independent_px;
  loop.shared_px = covariance.shared_px;
  loop.analytic_covariance = covariance.analytic;
  return loop;
}

// Half of the points are further away than this [m]; infinite where half of them are at infinity.
double MedianDepth_m(const RigSolution& solution) {
  std::vector<double> inverse;
  for (const InverseDistancePoint& point : solution.refinement.points) {
    inverse.push_back(point.inverse_distance);
  }
  if (inverse.empty()) return 0.0;
  const auto middle = inverse.begin() + static_cast<std::ptrdiff_t>(inverse.size() / 2);
  std::nth_element(inverse.begin(), middle, inverse.end());
  return *middle > 0.0 ? 1.0 / *middle : std::numeric_limits<double>::infinity();
}

double RowVariance_rad2(const RefinedRig& rig, int camera) {
  return rig.exposures.empty() ? 0.0 : RowVariance_rad2(rig.exposures[static_cast<size_t>(camera)]);
}

// The longest motion within a rig, in standard deviations of what odometry says about it: one that
// cannot be told from none says nothing about the scale. Nor does one whose parallax at the scene's
// depth cannot be told from what the rows of turning cameras do to it.
double LongestBaselineSigmas(const LoopProblem& problem, double depth_m) {
  double longest = 0.0;
  for (const RefinedRig* rig : {&problem.cand, &problem.query}) {
    for (const RigMotion& motion : rig->motions) {
      const Eigen::Vector3d t = (rig->T_rig_cam[static_cast<size_t>(motion.from)].inverse() *
                                 rig->T_rig_cam[static_cast<size_t>(motion.to)])
                                    .translation();
      const double rows_rad2 =
          RowVariance_rad2(*rig, motion.from) + RowVariance_rad2(*rig, motion.to);
      Eigen::Matrix3d covariance = motion.covariance.bottomRightCorner<3, 3>();
      if (rows_rad2 > 0.0) covariance.diagonal().array() += depth_m * depth_m * rows_rad2;
      const double sigmas2 = t.dot(covariance.llt().solve(t));
      longest = std::max(longest, std::isfinite(sigmas2) ? std::sqrt(sigmas2) : 0.0);
    }
  }
  return longest;
}

LoopResult Estimate(const LoopProblem& problem, const FastLoopOptions& options, StageClock& clock) {
  const double min_num_inliers = static_cast<double>(options.min_num_inliers);
  clock.Start("hypotheses");
  const std::vector<RigHypothesis> hypotheses =
      EstimateRigHypotheses(problem.matched.rigs, options.hypotheses, options.seed);
  clock.Start("refinement");
  std::vector<RigSolution> solutions = FindContenders(problem, hypotheses, options);
  const double baseline_sigmas =
      solutions.empty() ? 0.0 : LongestBaselineSigmas(problem, MedianDepth_m(solutions[0]));
  if (!solutions.empty() && solutions[0].score.num_inliers >= options.min_num_inliers &&
      baseline_sigmas < options.min_baseline_sigmas) {
    return LoopRejection{"scale", std::nullopt, baseline_sigmas, options.min_baseline_sigmas};
  }
  // A search finds better optima, not twice as many inliers.
  if (!solutions.empty() && 2 * solutions[0].score.num_inliers >= options.min_num_inliers &&
      FindRival(problem, solutions, options)) {
    solutions = SearchOn(problem, std::move(solutions), options);
  }
  const int num_inliers = solutions.empty() ? 0 : solutions[0].score.num_inliers;
  if (num_inliers < options.min_num_inliers || solutions.empty()) {
    return LoopRejection{"rig_inliers", std::nullopt, static_cast<double>(num_inliers),
                         min_num_inliers};
  }
  if (std::optional<LoopRejection> rejection = CheckUnambiguous(problem, solutions, options)) {
    return *rejection;
  }
  if (std::optional<LoopRejection> rejection = CheckMotions(solutions[0], options)) {
    return *rejection;
  }
  clock.Start("covariance");
  const LoopEstimate loop = MakeEstimate(problem, solutions[0], options);
  if (std::optional<LoopRejection> rejection = CheckPlausible(loop, options)) return *rejection;
  return loop;
}

LoopResult Solve(const LoopRig& query,
                 const LoopRig& cand,
                 const FastLoopOptions& options,
                 StageClock& clock) {
  LoopProblem problem{{}, RigOf(query), RigOf(cand)};
  clock.Start("matching");
  problem.matched =
      MatchRigs(query.cameras, cand.cameras, options.matching, options.instruction_set);
  const double baseline_m = LongestBaseline_m(problem.matched.rigs);
  if (baseline_m < options.min_baseline_m) {
    return LoopRejection{"degenerate", std::nullopt, baseline_m, options.min_baseline_m};
  }
  const int num_matches = static_cast<int>(problem.matched.rigs.NumMatches());
  if (num_matches < options.min_num_inliers) {
    return LoopRejection{"matches", std::nullopt, static_cast<double>(num_matches),
                         static_cast<double>(options.min_num_inliers)};
  }
  return Estimate(problem, options, clock);
}

}  // namespace

void FastLoopOptions::Check() const {
  matching.Check();
  hypotheses.Check();
  refinement.Check();
  depth.Check();
  selection.Check();
  covariance.Check();
  if (max_num_refined < 1 || max_num_trial_tracks < 1 || max_num_trial_iterations < 0 ||
      max_num_rounds < 1 || min_num_inliers < 0) {
    throw std::invalid_argument("FastLoopOptions: numbers must not be negative");
  }
  if (!(min_inlier_share >= 0.0 && min_inlier_share <= 1.0)) {
    throw std::invalid_argument("FastLoopOptions.min_inlier_share must be in [0, 1]");
  }
  if (!(min_baseline_m > 0.0 && min_baseline_sigmas >= 0.0 && max_sigma_translation_m > 0.0 &&
        max_translation_m > 0.0 && max_rotation_rad > 0.0)) {
    throw std::invalid_argument("FastLoopOptions: limits must be positive");
  }
  if (!(min_motion_probability >= 0.0 && min_motion_probability < 1.0)) {
    throw std::invalid_argument("FastLoopOptions.min_motion_probability must be in [0, 1)");
  }
}

LoopResult SolveLoopFast(const LoopRig& query,
                         const LoopRig& cand,
                         const FastLoopOptions& options) {
  FastLoopOptions all = options;
  all.hypotheses.instruction_set = all.refinement.instruction_set = options.instruction_set;
  all.Check();
  StageClock clock;
  LoopResult result = Solve(query, cand, all, clock);
  std::visit([&clock](auto& value) { value.stage_ms = clock.Times(); }, result);
  return result;
}

}  // namespace covinz
