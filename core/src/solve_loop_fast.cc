// Matching, hypotheses, refinement, selection, covariance: the fast profile as one pipeline.
#include "covinz/solve_loop_fast.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include <Eigen/Cholesky>

#include "covinz/planar_twin.h"
#include "covinz/rig_tracks.h"
#include "matched_rigs.h"
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
  return result;
}

// Everything that refinement and selection work on.
struct Problem {
  MatchedRigs matched;
  RefinedRig query;
  RefinedRig cand;
};

// A refined hypothesis.
struct Solution {
  RigTracks tracks;
  RigRefinement refinement;
  SolutionScore score;
};

// Where a refinement starts; the rigs also say which tracks contradict one another and which are
// out of the scene.
struct Start {
  const RefinedRig& cand;
  const RefinedRig& query;
  const std::vector<std::vector<int>>& inliers;
  const Eigen::Isometry3d& T_cand_query;
  double depth_sigma_px;  // the rigs are wrong about depths by what such a keypoint error does
};

Solution Refine(const Problem& problem,
                const Start& start,
                int max_num_tracks,
                int max_num_iterations,
                const FastLoopOptions& options) {
  RigPairs rigs = problem.matched.rigs;
  rigs.T_cand_cam = start.cand.T_rig_cam;
  rigs.T_query_cam = start.query.T_rig_cam;
  RigRefinementOptions depth_options = options.refinement;
  depth_options.sigma_px = start.depth_sigma_px;
  RigRefinementOptions refinement_options = options.refinement;
  refinement_options.max_num_iterations = max_num_iterations;
  Solution solution;
  const RigTracks tracks =
      MergeTracks(InlierLinks(rigs, problem.matched.keypoints, start.inliers, start.T_cand_query));
  solution.tracks =
      ThinTracks(DropImplausibleTracks(start.cand, start.query, tracks, start.T_cand_query,
                                       depth_options, options.depth),
                 max_num_tracks);
  solution.refinement = RefineRigs(problem.cand, problem.query, solution.tracks, start.T_cand_query,
                                   refinement_options);
  solution.score = ScoreSolution(problem.matched.rigs, solution.refinement, options.refinement,
                                 options.selection);
  return solution;
}

// Keypoint error [px] that does to depths what the odometry of both rigs does.
double DepthSigma_px(const Problem& problem, const RigRefinementOptions& options) {
  double sigma_px = options.sigma_px;
  for (const RefinedRig* rig : {&problem.cand, &problem.query}) {
    for (const RigMotion& motion : rig->motions) {
      const double turn_rad = std::sqrt(motion.covariance.diagonal().head<3>().maxCoeff());
      sigma_px = std::max(sigma_px, std::hypot(options.sigma_px, turn_rad * rig->focal_px[0]));
    }
  }
  return sigma_px;
}

// As far as ranking needs it, from odometry's rigs.
Solution RefineTrial(const Problem& problem,
                     const std::vector<std::vector<int>>& inliers,
                     const Eigen::Isometry3d& T_cand_query,
                     const FastLoopOptions& options) {
  const Start start{problem.cand, problem.query, inliers, T_cand_query,
                    DepthSigma_px(problem, options.refinement)};
  return Refine(problem, start, options.max_num_trial_tracks, options.max_num_trial_iterations,
                options);
}

// To the end, each time over all matches that the last refinement explains, until these hardly grow
// any more: rigs that are still as odometry has them explain but a part.
Solution RefineToTheEnd(const Problem& problem, Solution solution, const FastLoopOptions& options) {
  for (int round = 0; round < options.max_num_rounds; ++round) {
    const int num_inliers = solution.score.num_inliers;
    RefinedRig cand = problem.cand;
    RefinedRig query = problem.query;
    cand.T_rig_cam = solution.refinement.T_cand_cam;
    query.T_rig_cam = solution.refinement.T_query_cam;
    const Start start{cand, query, solution.score.inliers, solution.refinement.T_cand_query,
                      options.refinement.sigma_px};
    solution = Refine(problem, start, std::numeric_limits<int>::max(),
                      options.refinement.max_num_iterations, options);
    if (solution.score.num_inliers <= 1.02 * num_inliers) break;
  }
  return solution;
}

void SortByCost(std::vector<Solution>& solutions) {
  std::stable_sort(solutions.begin(), solutions.end(), [](const Solution& a, const Solution& b) {
    return a.score.cost < b.score.cost;
  });
}

// The refined hypotheses, the best one first.
std::vector<Solution> RefineHypotheses(const Problem& problem,
                                       const std::vector<RigHypothesis>& hypotheses,
                                       const FastLoopOptions& options) {
  std::vector<Solution> solutions;
  for (const RigHypothesis& hypothesis : hypotheses) {
    if (static_cast<int>(solutions.size()) == options.max_num_refined) break;
    if (hypothesis.num_inliers < options.min_inlier_share * hypotheses[0].num_inliers) continue;
    solutions.push_back(RefineTrial(problem, hypothesis.inliers, hypothesis.T_cand_query, options));
  }
  SortByCost(solutions);
  return solutions;
}

RefinementCovariance CovarianceOf(const Problem& problem,
                                  const Solution& solution,
                                  const FastLoopOptions& options) {
  return EstimateRefinementCovariance(problem.cand, problem.query, solution.tracks,
                                      solution.refinement, options.refinement, options.covariance);
}

LoopSolution Report(const Problem& problem,
                    const Solution& solution,
                    const FastLoopOptions& options) {
  return {solution.refinement.T_cand_query, CovarianceOf(problem, solution, options).covariance,
          solution.score.num_inliers, solution.score.cost};
}

// The best solution's twin, were the scene flat, refined to the end: no sampling is sure to find
// it, and on scenes with little relief it may be the truth.
std::optional<Solution> RefineTwin(const Problem& problem,
                                   const Solution& best,
                                   const FastLoopOptions& options) {
  const Eigen::Isometry3d& T_cand_world = problem.cand.T_rig_cam[0];
  const Eigen::Isometry3d& T_query_cam = problem.query.T_rig_cam[0];
  const std::optional<Eigen::Isometry3d> T_world_cam = PlanarTwin(
      T_cand_world.inverse() * best.refinement.T_cand_query * T_query_cam, best.refinement.points);
  if (!T_world_cam) return std::nullopt;
  const Eigen::Isometry3d T_cand_query = T_cand_world * *T_world_cam * T_query_cam.inverse();
  if (AreEqual(T_cand_query, best.refinement.T_cand_query, options.selection)) return std::nullopt;
  const Solution trial = RefineTrial(problem, best.score.inliers, T_cand_query, options);
  if (AreEqual(trial.refinement.T_cand_query, best.refinement.T_cand_query, options.selection) ||
      Significance(problem.matched.rigs, best.score, trial.score, options.selection) >=
          options.selection.min_significance) {
    return std::nullopt;
  }
  return RefineToTheEnd(problem, trial, options);
}

// The best of the trial solutions and those that it is not clearly ahead of, refined to the end,
// the best one first: a trial may rank two optima wrongly, or be on its way to the same one.
std::vector<Solution> RefineContenders(const Problem& problem,
                                       const std::vector<Solution>& trials,
                                       const FastLoopOptions& options) {
  std::vector<Solution> contenders;
  for (const Solution& trial : trials) {
    const bool clearly_behind =
        Significance(problem.matched.rigs, trials[0].score, trial.score, options.selection) >=
        options.selection.min_significance;
    const bool known = std::any_of(
        contenders.begin(), contenders.end(), [&trial, &options](const Solution& contender) {
          return AreEqual(contender.refinement.T_cand_query, trial.refinement.T_cand_query,
                          options.selection);
        });
    if (clearly_behind || known) continue;
    contenders.push_back(RefineToTheEnd(problem, trial, options));
  }
  SortByCost(contenders);
  if (contenders.empty()) return contenders;
  if (std::optional<Solution> twin = RefineTwin(problem, contenders[0], options)) {
    contenders.push_back(std::move(*twin));
    SortByCost(contenders);
  }
  return contenders;
}

// Whether a distinct solution is nearly as good.
std::optional<LoopRejection> CheckUnambiguous(const Problem& problem,
                                              const std::vector<Solution>& contenders,
                                              const FastLoopOptions& options) {
  const Solution& best = contenders[0];
  for (const Solution& other : contenders) {
    if (!AreDistinct(best.refinement.T_cand_query, other.refinement.T_cand_query,
                     options.selection)) {
      continue;
    }
    const double ahead =
        Significance(problem.matched.rigs, best.score, other.score, options.selection);
    if (ahead >= options.selection.min_significance) continue;
    LoopRejection rejection{"ambiguous", std::nullopt, ahead, options.selection.min_significance};
    rejection.solutions = {Report(problem, best, options), Report(problem, other, options)};
    return rejection;
  }
  return std::nullopt;
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

LoopEstimate MakeEstimate(const Problem& problem,
                          const Solution& solution,
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
  return loop;
}

LoopResult Estimate(const Problem& problem, const FastLoopOptions& options, StageClock& clock) {
  const double min_num_inliers = static_cast<double>(options.min_num_inliers);
  clock.Start("hypotheses");
  const std::vector<RigHypothesis> hypotheses =
      EstimateRigHypotheses(problem.matched.rigs, options.hypotheses, options.seed);
  clock.Start("refinement");
  const std::vector<Solution> solutions =
      RefineContenders(problem, RefineHypotheses(problem, hypotheses, options), options);
  const int num_inliers = solutions.empty() ? 0 : solutions[0].score.num_inliers;
  if (num_inliers < options.min_num_inliers || solutions.empty()) {
    return LoopRejection{"rig_inliers", std::nullopt, static_cast<double>(num_inliers),
                         min_num_inliers};
  }
  if (std::optional<LoopRejection> rejection = CheckUnambiguous(problem, solutions, options)) {
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
  Problem problem{{}, RigOf(query), RigOf(cand)};
  problem.query.Check();
  problem.cand.Check();
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
  if (!(min_baseline_m > 0.0 && max_sigma_translation_m > 0.0 && max_translation_m > 0.0 &&
        max_rotation_rad > 0.0)) {
    throw std::invalid_argument("FastLoopOptions: limits must be positive");
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
