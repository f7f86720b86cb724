// Scores of solutions and the test whether the best one is clearly ahead.
#include "covinz/rig_selection.h"

#include <cmath>

#include <gtest/gtest.h>

#include "refinement_problem.h"

namespace covinz {
namespace {

RefinementProblem Ordinary(uint64_t seed) {
  RefinementProblemOptions options;
  options.seed = seed;
  options.outlier_share = 0.3;
  return MakeRefinementProblem(options);
}

RigRefinement Solve(const RefinementProblem& problem) {
  return RefineRigs(problem.cand, problem.query, problem.Tracks(problem.T_cand_query),
                    problem.T_cand_query, {});
}

// The same rigs elsewhere.
RigRefinement Moved(RigRefinement solution, double distance_m) {
  solution.T_cand_query.translation().x() += distance_m;
  return solution;
}

SolutionScore Score(const RefinementProblem& problem, const RigRefinement& solution) {
  return ScoreSolution(problem.rigs, solution, {}, {});
}

TEST(ScoreSolution, FindsTheTrueMatches) {
  const RefinementProblem problem = Ordinary(1);
  const SolutionScore score = Score(problem, Solve(problem));
  size_t num_true = 0;
  for (const auto& inliers : problem.inliers) num_true += inliers.size();
  EXPECT_GT(score.num_inliers, 0.98 * double(num_true));
  EXPECT_LT(score.num_inliers, 1.05 * double(num_true));
  ASSERT_EQ(score.losses.size(), problem.rigs.NumMatches());
  double sum = score.motion_cost;
  for (const double loss : score.losses) {
    EXPECT_LE(loss, 9.0);
    sum += loss;
  }
  EXPECT_NEAR(score.cost, sum, 1e-9 * sum);
}

TEST(ScoreSolution, OdometryCounts) {
  const RefinementProblem problem = Ordinary(2);
  RigRefinement solution = Solve(problem);
  const double cost = Score(problem, solution).cost;
  solution.motion_residuals[0](3) += 10.0;
  EXPECT_GT(Score(problem, solution).cost, cost + 5.0);
}

TEST(AreDistinct, ByDistanceOrAngle) {
  const Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  const auto turned = [](double rad) {
    return Eigen::Isometry3d(Eigen::AngleAxisd(rad, Eigen::Vector3d::UnitY()));
  };
  EXPECT_FALSE(AreDistinct(T, T, {}));
  EXPECT_FALSE(AreDistinct(T, turned(0.05), {}));
  EXPECT_TRUE(AreDistinct(T, turned(0.06), {}));
  EXPECT_TRUE(AreDistinct(T, Eigen::Isometry3d(Eigen::Translation3d(0.0, 0.3, 0.0)), {}));
}

TEST(Significance, TheTruthIsClearlyAheadOfAWrongPose) {
  for (uint64_t seed = 0; seed < 5; ++seed) {
    const RefinementProblem problem = Ordinary(seed);
    const RigRefinement solution = Solve(problem);
    const SolutionScore truth = Score(problem, solution);
    const SolutionScore wrong = Score(problem, Moved(solution, 0.4));
    EXPECT_GT(Significance(problem.rigs, truth, wrong, {}), 3.0);
    EXPECT_NEAR(Significance(problem.rigs, wrong, truth, {}),
                -Significance(problem.rigs, truth, wrong, {}), 1e-9);
  }
}

TEST(Significance, EqualSolutionsAreNotAhead) {
  const RefinementProblem problem = Ordinary(6);
  const SolutionScore score = Score(problem, Solve(problem));
  EXPECT_EQ(Significance(problem.rigs, score, score, {}), 0.0);
}

TEST(Significance, OneCornerOfTheSceneDecidesNothing) {
  // All the evidence, however much, comes from one direction.
  const RefinementProblem problem = Ordinary(7);
  const SolutionScore best = Score(problem, Solve(problem));
  SolutionScore corner = best;
  SolutionScore everywhere = best;
  size_t match = 0;
  size_t num_worse = 0;
  for (const BearingPairs& pairs : problem.rigs.pairs) {
    for (size_t i = 0; i < pairs.size(); ++i, ++match) {
      const Eigen::Vector3d ray =
          problem.rigs.T_query_cam[size_t(pairs.query_cam)].linear() * pairs.query[i];
      if (std::abs(ray.x() / ray.z() - 0.3) < 0.1 && std::abs(ray.y() / ray.z() - 0.1) < 0.1) {
        corner.losses[match] += 6.0;
        ++num_worse;
      }
    }
  }
  ASSERT_GT(num_worse, 10u);
  for (size_t i = 0; i < match; ++i)
    everywhere.losses[i] += 6.0 * double(num_worse) / double(match);
  EXPECT_LT(Significance(problem.rigs, best, corner, {}), 3.0);
  EXPECT_GT(Significance(problem.rigs, best, everywhere, {}), 3.0);
}

TEST(Significance, LittleEvidenceIsNotSignificantHoweverUnanimous) {
  const RefinementProblem problem = Ordinary(8);
  const SolutionScore best = Score(problem, Solve(problem));
  SolutionScore other = best;
  for (double& loss : other.losses) loss += 10.0 / double(other.losses.size());
  // A log-likelihood ratio of 5, less than the 7 asked for.
  EXPECT_LT(Significance(problem.rigs, best, other, {}), 3.0);
}

TEST(RigSelectionOptions, Check) {
  const auto throws = [](auto change) {
    RigSelectionOptions options;
    change(options);
    EXPECT_THROW(options.Check(), std::invalid_argument);
  };
  EXPECT_NO_THROW(RigSelectionOptions{}.Check());
  throws([](RigSelectionOptions& o) { o.sigma_px = 0.0; });
  throws([](RigSelectionOptions& o) { o.max_error_sigmas = -1.0; });
  throws([](RigSelectionOptions& o) { o.cell_rad = 0.0; });
  throws([](RigSelectionOptions& o) { o.min_distinct_m = -1.0; });
  throws([](RigSelectionOptions& o) { o.min_significance = 0.0; });
}

}  // namespace
}  // namespace covinz
