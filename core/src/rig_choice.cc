// Contenders, their twins, and the search for better ones.
#include "rig_choice.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include <Eigen/Eigenvalues>

#include "covinz/planar_twin.h"
#include "covinz/rig_covariance.h"

namespace covinz {
namespace {

using Solutions = std::vector<RigSolution>;

// Of starts along the valley, in units of what makes solutions distinct.
constexpr double kValleySteps[] = {-3.0, -1.5, 1.5, 3.0};

void SortByCost(Solutions& solutions) {
  std::stable_sort(
      solutions.begin(), solutions.end(),
      [](const RigSolution& a, const RigSolution& b) { return a.score.cost < b.score.cost; });
}

// The refined hypotheses, the best one first.
Solutions RefineTrials(const LoopProblem& problem,
                       const std::vector<RigHypothesis>& hypotheses,
                       const FastLoopOptions& options) {
  Solutions solutions;
  for (const RigHypothesis& hypothesis : hypotheses) {
    if (static_cast<int>(solutions.size()) == options.max_num_refined) break;
    if (hypothesis.num_inliers < options.min_inlier_share * hypotheses[0].num_inliers) continue;
    solutions.push_back(RefineTrial(problem, hypothesis.inliers, hypothesis.T_cand_query, options));
  }
  SortByCost(solutions);
  return solutions;
}

// The best solution's twin, were the scene flat, refined to the end: no sampling is sure to find
// it, and on scenes with little relief it may be the truth.
std::optional<RigSolution> RefineTwin(const LoopProblem& problem,
                                      const RigSolution& best,
                                      const FastLoopOptions& options) {
  const Eigen::Isometry3d& T_cand_world = problem.cand.T_rig_cam[0];
  const Eigen::Isometry3d& T_query_cam = problem.query.T_rig_cam[0];
  const std::optional<Eigen::Isometry3d> T_world_cam = PlanarTwin(
      T_cand_world.inverse() * best.refinement.T_cand_query * T_query_cam, best.refinement.points);
  if (!T_world_cam) return std::nullopt;
  const Eigen::Isometry3d T_cand_query = T_cand_world * *T_world_cam * T_query_cam.inverse();
  if (AreEqual(T_cand_query, best.refinement.T_cand_query, options.selection)) return std::nullopt;
  const RigSolution trial = RefineTrial(problem, best.score.inliers, T_cand_query, options);
  if (AreEqual(trial.refinement.T_cand_query, best.refinement.T_cand_query, options.selection) ||
      Significance(problem.matched.rigs, best.score, trial.score, options.selection) >=
          options.selection.min_significance) {
    return std::nullopt;
  }
  return RefineToTheEnd(problem, trial, options);
}

// Adds a solution, or puts it in place of one at the same optimum that is worse.
void Insert(RigSolution solution, const FastLoopOptions& options, Solutions& solutions) {
  const auto same =
      std::find_if(solutions.begin(), solutions.end(), [&solution, &options](const RigSolution& s) {
        return AreEqual(s.refinement.T_cand_query, solution.refinement.T_cand_query,
                        options.selection);
      });
  if (same == solutions.end()) {
    solutions.push_back(std::move(solution));
  } else if (solution.score.cost < same->score.cost) {
    *same = std::move(solution);
  }
  SortByCost(solutions);
}

// Behind by twice what would decide: a trial has only begun to converge.
bool IsHopeless(const LoopProblem& problem,
                const RigSolution& best,
                const RigSolution& trial,
                const FastLoopOptions& options) {
  return Significance(problem.matched.rigs, best.score, trial.score, options.selection) >=
         2.0 * options.selection.min_significance;
}

// On its way to an optimum that is known.
bool IsKnown(const RigSolution& trial,
             const Solutions& contenders,
             const FastLoopOptions& options) {
  return std::any_of(contenders.begin(), contenders.end(),
                     [&trial, &options](const RigSolution& contender) {
                       return AreEqual(contender.refinement.T_cand_query,
                                       trial.refinement.T_cand_query, options.selection);
                     });
}

// Hypotheses of a sampling of its own that does not stop early.
std::vector<RigHypothesis> SampleOn(const LoopProblem& problem, const FastLoopOptions& options) {
  RigHypothesisOptions sampling = options.hypotheses;
  sampling.instruction_set = options.instruction_set;
  sampling.min_num_iterations = sampling.max_num_iterations;
  return EstimateRigHypotheses(problem.matched.rigs, sampling, ~options.seed);
}

Matrix6d CovarianceOf(const LoopProblem& problem,
                      const RigSolution& solution,
                      const FastLoopOptions& options) {
  return EstimateRefinementCovariance(problem.cand, problem.query, solution.tracks,
                                      solution.refinement, options.refinement, options.covariance)
      .covariance;
}

// Whether a solution's own covariance allows for another one.
bool AllowsFor(const Matrix6d& covariance,
               const RigSolution& solution,
               const RigSolution& other,
               const FastLoopOptions& options) {
  const Vector6d xi =
      LogSE3(solution.refinement.T_cand_query.inverse() * other.refinement.T_cand_query);
  const double sigmas = options.selection.max_valley_sigmas;
  return xi.dot(covariance.llt().solve(xi)) <= sigmas * sigmas;
}

// Starts to both sides of a solution, along the direction that it determines least in proportion to
// what makes solutions distinct.
std::vector<RigPoses> AlongTheValley(const LoopProblem& problem,
                                     const RigSolution& solution,
                                     const FastLoopOptions& options) {
  const Matrix6d covariance = CovarianceOf(problem, solution, options);
  Vector6d unit;
  unit.head<3>().setConstant(options.selection.min_distinct_rad);
  unit.tail<3>().setConstant(options.selection.min_distinct_m);
  const Matrix6d scaled =
      unit.cwiseInverse().asDiagonal() * covariance * unit.cwiseInverse().asDiagonal();
  const Vector6d weakest =
      unit.cwiseProduct(Eigen::SelfAdjointEigenSolver<Matrix6d>(scaled).eigenvectors().col(5));
  std::vector<RigPoses> starts;
  for (const double step : kValleySteps) {
    starts.push_back(solution.Poses());
    starts.back().T_cand_query = starts.back().T_cand_query * ExpSE3(step * weakest);
  }
  return starts;
}

std::vector<std::vector<int>> Union(const std::vector<std::vector<int>>& a,
                                    const std::vector<std::vector<int>>& b) {
  std::vector<std::vector<int>> both(a.size());
  for (size_t p = 0; p < a.size(); ++p) {
    std::set_union(a[p].begin(), a[p].end(), b[p].begin(), b[p].end(), std::back_inserter(both[p]));
  }
  return both;
}

// Refines a trial that leads to a new optimum which might decide, and adds it.
void Follow(const LoopProblem& problem,
            const RigSolution& trial,
            const FastLoopOptions& options,
            Solutions& contenders) {
  if (IsKnown(trial, contenders, options) || IsHopeless(problem, contenders[0], trial, options)) {
    return;
  }
  Insert(RefineToTheEnd(problem, trial, options), options, contenders);
}

// Drops contenders that are clearly behind the best one or in one valley with it.
Solutions MergeValley(const LoopProblem& problem,
                      const Solutions& contenders,
                      const FastLoopOptions& options) {
  const Matrix6d covariance = CovarianceOf(problem, contenders[0], options);
  Solutions kept = {contenders[0]};
  for (size_t i = 1; i < contenders.size(); ++i) {
    const RigSolution& other = contenders[i];
    if (Significance(problem.matched.rigs, contenders[0].score, other.score, options.selection) >=
        options.selection.min_significance) {
      continue;
    }
    // Over the inliers of both a solution in one valley with the best one ends where that does. A
    // second optimum may do so too, drawn by the other's inliers: then it stays a rival.
    RigSolution merged = RefineToTheEnd(
        problem, other.Poses(), Union(contenders[0].score.inliers, other.score.inliers), options);
    const bool is_drawn = !AreDistinct(merged.refinement.T_cand_query,
                                       contenders[0].refinement.T_cand_query, options.selection) &&
                          !AllowsFor(covariance, contenders[0], other, options);
    Insert(std::move(merged), options, kept);
    if (is_drawn) Insert(other, options, kept);
    if (FindRival(problem, kept, options)) break;
  }
  return kept;
}

}  // namespace

// The best of the trial solutions and those that it is not clearly ahead of, refined to the end,
// the best one first: a trial may rank two optima wrongly, or be on its way to the same one.
std::vector<RigSolution> FindContenders(const LoopProblem& problem,
                                        const std::vector<RigHypothesis>& hypotheses,
                                        const FastLoopOptions& options) {
  const Solutions trials = RefineTrials(problem, hypotheses, options);
  Solutions contenders;
  for (const RigSolution& trial : trials) {
    const bool clearly_behind =
        Significance(problem.matched.rigs, trials[0].score, trial.score, options.selection) >=
        options.selection.min_significance;
    if (clearly_behind || IsKnown(trial, contenders, options)) continue;
    contenders.push_back(RefineToTheEnd(problem, trial, options));
  }
  SortByCost(contenders);
  if (contenders.empty()) return contenders;
  if (std::optional<RigSolution> twin = RefineTwin(problem, contenders[0], options)) {
    contenders.push_back(std::move(*twin));
    SortByCost(contenders);
  }
  return contenders;
}

std::optional<Rival> FindRival(const LoopProblem& problem,
                               const std::vector<RigSolution>& contenders,
                               const FastLoopOptions& options) {
  const RigSolution& best = contenders[0];
  for (size_t i = 1; i < contenders.size(); ++i) {
    const RigSolution& other = contenders[i];
    if (!AreDistinct(best.refinement.T_cand_query, other.refinement.T_cand_query,
                     options.selection)) {
      continue;
    }
    const double ahead =
        Significance(problem.matched.rigs, best.score, other.score, options.selection);
    if (ahead < options.selection.min_significance) return Rival{i, ahead};
  }
  return std::nullopt;
}

std::vector<RigSolution> SearchOn(const LoopProblem& problem,
                                  std::vector<RigSolution> contenders,
                                  const FastLoopOptions& options) {
  const auto settle = [&] {
    for (const RigPoses& start : AlongTheValley(problem, contenders[0], options)) {
      Follow(problem, RefineTrial(problem, contenders[0].score.inliers, start, options), options,
             contenders);
    }
    return MergeValley(problem, contenders, options);
  };
  Solutions kept = settle();
  if (kept[0].score.num_inliers < options.min_num_inliers || FindRival(problem, kept, options)) {
    return kept;
  }
  const std::vector<RigHypothesis> hypotheses = SampleOn(problem, options);
  const size_t num_refined =
      std::min(hypotheses.size(), static_cast<size_t>(options.max_num_refined));
  for (size_t i = 0; i < num_refined; ++i) {
    const RigHypothesis& hypothesis = hypotheses[i];
    Follow(problem, RefineTrial(problem, hypothesis.inliers, hypothesis.T_cand_query, options),
           options, contenders);
  }
  return settle();
}

}  // namespace covinz
