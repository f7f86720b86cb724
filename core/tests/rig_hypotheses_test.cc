// Joint estimation over raw matches: truth, outliers, second solutions, invariance, faults.
#include "covinz/rig_hypotheses.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "rig_problem.h"

namespace covinz {
namespace {

// What an ordinary hand-held run gives: 0.7 px, 6 mm and 0.11 degrees between keyframes.
RigProblemOptions Ordinary(uint64_t seed, double outlier_ratio) {
  RigProblemOptions options;
  options.noise_px = 0.7;
  options.odometry_noise_m = 0.006;
  options.odometry_noise_rad = 0.002;
  options.outlier_ratio = outlier_ratio;
  options.seed = seed;
  return options;
}

RigPairs Swapped(const RigPairs& rigs) {
  RigPairs swapped{rigs.T_cand_cam, rigs.T_query_cam, rigs.pairs};
  for (BearingPairs& pairs : swapped.pairs) {
    std::swap(pairs.query_cam, pairs.cand_cam);
    std::swap(pairs.query_focal_px, pairs.cand_focal_px);
    std::swap(pairs.query, pairs.cand);
  }
  return swapped;
}

// Every n-th match of each pair is what another loop of the same rigs would give.
RigProblem WithSecondLoop(const RigProblem& first, const RigProblem& second, size_t n) {
  RigProblem both = first;
  for (size_t p = 0; p < both.rigs.pairs.size(); ++p) {
    for (size_t i = 0; i < both.rigs.pairs[p].size(); i += n) {
      both.rigs.pairs[p].query[i] = second.rigs.pairs[p].query[i];
      both.rigs.pairs[p].cand[i] = second.rigs.pairs[p].cand[i];
    }
  }
  return both;
}

bool HasNear(const std::vector<RigHypothesis>& hypotheses,
             const Eigen::Isometry3d& T,
             double max_rad,
             double max_m) {
  return std::any_of(hypotheses.begin(), hypotheses.end(), [&](const RigHypothesis& h) {
    const Vector6d error = PoseError(T, h.T_cand_query);
    return error.head<3>().norm() < max_rad && error.tail<3>().norm() < max_m;
  });
}

TEST(EstimateRigHypotheses, ExactWithoutNoise) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    RigProblemOptions options;
    options.seed = seed;
    const RigProblem problem = MakeRigProblem(options);
    const auto hypotheses = EstimateRigHypotheses(problem.rigs, {}, seed);
    ASSERT_FALSE(hypotheses.empty());
    EXPECT_LT(PoseError(problem.T_cand_query, hypotheses[0].T_cand_query).norm(), 1e-5);
    EXPECT_EQ(hypotheses[0].num_inliers, static_cast<int>(problem.rigs.NumMatches()));
    EXPECT_NEAR(hypotheses[0].cost, 0.0, 1e-6);
  }
}

class Outliers : public testing::TestWithParam<double> {};

TEST_P(Outliers, TheBestIsNearTheTruth) {
  std::vector<double> rotation_rad, translation_m;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    const RigProblem problem = MakeRigProblem(Ordinary(seed, GetParam()));
    const auto hypotheses = EstimateRigHypotheses(problem.rigs, {}, seed);
    ASSERT_FALSE(hypotheses.empty());
    const Vector6d error = PoseError(problem.T_cand_query, hypotheses[0].T_cand_query);
    rotation_rad.push_back(error.head<3>().norm());
    translation_m.push_back(error.tail<3>().norm());
    // Chance adds a few.
    const double num_right = (1.0 - GetParam()) * static_cast<double>(problem.rigs.NumMatches());
    EXPECT_NEAR(hypotheses[0].num_inliers, num_right, 0.15 * num_right);
  }
  std::sort(rotation_rad.begin(), rotation_rad.end());
  std::sort(translation_m.begin(), translation_m.end());
  EXPECT_LT(rotation_rad[10], 0.006);
  EXPECT_LT(translation_m[10], 0.03);
  EXPECT_LT(rotation_rad[19], 0.02);
  EXPECT_LT(translation_m[19], 0.08);
}

INSTANTIATE_TEST_SUITE_P(Shares, Outliers, testing::Values(0.0, 0.3, 0.5, 0.6));

TEST(EstimateRigHypotheses, PairsMayDifferWidely) {
  // Two pairs hold nearly all the matches, the others a handful or none.
  RigProblem problem = MakeRigProblem(Ordinary(1, 0.3));
  for (size_t p = 0; p < problem.rigs.pairs.size(); ++p) {
    const size_t size = p == 0 || p == 4 ? 150 : 2 * p - 2 * (p == 1);
    problem.rigs.pairs[p].query.resize(size);
    problem.rigs.pairs[p].cand.resize(size);
  }
  const auto hypotheses = EstimateRigHypotheses(problem.rigs, {}, 1);
  EXPECT_TRUE(HasNear(hypotheses, problem.T_cand_query, 0.02, 0.08));
}

TEST(EstimateRigHypotheses, BothOfTwoSolutionsAreFound) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    const RigProblemOptions options = Ordinary(seed, 0.2);
    const RigProblem first = MakeRigProblem(options);
    // Turned and moved by 0.5 m from the first loop.
    std::mt19937_64 engine(seed + 100);
    RigProblemOptions moved = options;
    moved.T_cand_query = first.T_cand_query * RandomPose(engine, 0.15, 0.5);
    const RigProblem second = MakeRigProblem(moved);
    const RigProblem both = WithSecondLoop(first, second, 2);
    const auto hypotheses = EstimateRigHypotheses(both.rigs, {}, seed);
    EXPECT_TRUE(HasNear(hypotheses, first.T_cand_query, 0.02, 0.1)) << seed;
    EXPECT_TRUE(HasNear(hypotheses, second.T_cand_query, 0.02, 0.1)) << seed;
  }
}

// At 82 % outliers five points of one pair are rarely all right, four of any pairs more often.
TEST(EstimateRigHypotheses, VerticalsProposeWhereOutliersAreMany) {
  int without = 0, with = 0;
  for (uint64_t seed = 0; seed < 12; ++seed) {
    const RigProblem problem = MakeRigProblem(Ordinary(seed, 0.82));
    const auto found = [&](const RigHypothesisOptions& options) {
      return HasNear(EstimateRigHypotheses(problem.rigs, options, seed), problem.T_cand_query, 0.03,
                     0.15);
    };
    without += found({});
    std::mt19937_64 engine(seed);
    const Eigen::Vector3d up = RandomNormal3(engine, 1.0).normalized();
    RigHypothesisOptions options;
    const auto tilted = [&](const Eigen::Vector3d& v) {
      return ExpSO3(RandomNormal3(engine, options.vertical_sigma_rad)) * v;
    };
    options.verticals = Verticals{tilted(up), tilted(problem.T_cand_query.linear() * up)};
    with += found(options);
  }
  EXPECT_GT(with, without);
  EXPECT_GE(with, 7);
}

// Wrong verticals waste half of the samples and do no other harm.
TEST(EstimateRigHypotheses, WrongVerticalsDoNoHarm) {
  for (uint64_t seed = 0; seed < 5; ++seed) {
    const RigProblem problem = MakeRigProblem(Ordinary(seed, 0.3));
    RigHypothesisOptions options;
    options.verticals = Verticals{Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitZ()};
    const auto hypotheses = EstimateRigHypotheses(problem.rigs, options, seed);
    ASSERT_FALSE(hypotheses.empty());
    const Vector6d error = PoseError(problem.T_cand_query, hypotheses[0].T_cand_query);
    EXPECT_LT(error.head<3>().norm(), 0.02);
    EXPECT_LT(error.tail<3>().norm(), 0.08);
  }
}

TEST(EstimateRigHypotheses, AreDistinctAndInOrder) {
  const RigHypothesisOptions options;
  for (uint64_t seed = 0; seed < 10; ++seed) {
    RigProblemOptions hard = Ordinary(seed, 0.6);
    hard.min_depth_m = 5.0;
    const auto hypotheses = EstimateRigHypotheses(MakeRigProblem(hard).rigs, options, seed);
    ASSERT_FALSE(hypotheses.empty());
    EXPECT_LE(hypotheses.size(), 10u);
    for (size_t i = 1; i < hypotheses.size(); ++i) {
      EXPECT_LE(hypotheses[i - 1].cost, hypotheses[i].cost);
      for (size_t j = 0; j < i; ++j) {
        const Vector6d apart = PoseError(hypotheses[j].T_cand_query, hypotheses[i].T_cand_query);
        EXPECT_TRUE(apart.head<3>().norm() > options.max_same_angle_rad ||
                    apart.tail<3>().norm() > options.max_same_distance_m ||
                    hypotheses[i].inliers != hypotheses[j].inliers);
      }
    }
  }
}

TEST(EstimateRigHypotheses, InliersAndCostAreWhatTheyAreCalled) {
  const RigHypothesisOptions options;
  const RigProblem problem = MakeRigProblem(Ordinary(2, 0.4));
  for (const RigHypothesis& h : EstimateRigHypotheses(problem.rigs, options, 2)) {
    double cost = 0.0;
    size_t num_inliers = 0;
    const double limit = options.max_error_px * options.max_error_px;
    for (size_t p = 0; p < problem.rigs.pairs.size(); ++p) {
      const BearingPairs& pairs = problem.rigs.pairs[p];
      const Eigen::Isometry3d T = problem.rigs.T_cand_cam[size_t(pairs.cand_cam)].inverse() *
                                  h.T_cand_query *
                                  problem.rigs.T_query_cam[size_t(pairs.query_cam)];
      EXPECT_EQ(h.inliers[p], FindInliers(T, pairs, options.max_error_px));
      num_inliers += h.inliers[p].size();
      cost += limit * static_cast<double>(pairs.size() - h.inliers[p].size());
      for (const int i : h.inliers[p]) {
        cost += SquaredSampsonError_px2(EssentialMatrix(T), pairs, size_t(i));
      }
    }
    EXPECT_EQ(h.num_inliers, static_cast<int>(num_inliers));
    EXPECT_NEAR(h.cost, cost, 1e-6 * cost);
  }
}

TEST(EstimateRigHypotheses, SwapGivesTheInverse) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    const RigProblem problem = MakeRigProblem(Ordinary(seed, 0.3));
    const auto hypotheses = EstimateRigHypotheses(problem.rigs, {}, seed);
    const auto swapped = EstimateRigHypotheses(Swapped(problem.rigs), {}, seed);
    ASSERT_FALSE(hypotheses.empty() || swapped.empty());
    // The optimisation stops at steps of 1e-4.
    EXPECT_LT(PoseError(hypotheses[0].T_cand_query, swapped[0].T_cand_query.inverse()).norm(),
              1e-3);
  }
}

TEST(EstimateRigHypotheses, BodyFramesDoNotMatter) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    const RigProblem problem = MakeRigProblem(Ordinary(seed, 0.3));
    std::mt19937_64 engine(seed);
    const Eigen::Isometry3d T_new_old = RandomPose(engine, 1.0, 0.3);
    RigPairs moved = problem.rigs;
    for (Eigen::Isometry3d& T : moved.T_query_cam) T = T_new_old * T;
    for (Eigen::Isometry3d& T : moved.T_cand_cam) T = T_new_old * T;
    const auto hypotheses = EstimateRigHypotheses(problem.rigs, {}, seed);
    const auto other = EstimateRigHypotheses(moved, {}, seed);
    ASSERT_FALSE(hypotheses.empty() || other.empty());
    EXPECT_LT(PoseError(hypotheses[0].T_cand_query,
                        T_new_old.inverse() * other[0].T_cand_query * T_new_old)
                  .norm(),
              1e-4);
  }
}

TEST(EstimateRigHypotheses, SameSeedSameBitsOnEveryInstructionSet) {
  const RigProblem problem = MakeRigProblem(Ordinary(3, 0.5));
  RigHypothesisOptions options;
  options.instruction_set = InstructionSet::kPortable;
  const auto portable = EstimateRigHypotheses(problem.rigs, options, 5);
  ASSERT_FALSE(portable.empty());
  for (const InstructionSet instruction_set :
       {InstructionSet::kPortable, InstructionSet::kAvx2, InstructionSet::kAvx512}) {
    if (!IsSupported(instruction_set)) continue;
    options.instruction_set = instruction_set;
    const auto again = EstimateRigHypotheses(problem.rigs, options, 5);
    ASSERT_EQ(again.size(), portable.size());
    for (size_t i = 0; i < again.size(); ++i) {
      EXPECT_EQ(again[i].T_cand_query.matrix(), portable[i].T_cand_query.matrix());
      EXPECT_EQ(again[i].inliers, portable[i].inliers);
      EXPECT_EQ(again[i].cost, portable[i].cost);
    }
  }
}

TEST(EstimateRigHypotheses, NothingFromTooLittle) {
  RigProblemOptions options;
  options.num_points = 5;
  options.num_query_cams = options.num_cand_cams = 1;
  EXPECT_TRUE(EstimateRigHypotheses(MakeRigProblem(options).rigs, {}, 0).empty());
  options.num_points = 150;  // but one pair only
  EXPECT_TRUE(EstimateRigHypotheses(MakeRigProblem(options).rigs, {}, 0).empty());
  EXPECT_TRUE(EstimateRigHypotheses({}, {}, 0).empty());
}

TEST(EstimateRigHypotheses, NothingWithoutBaseline) {
  RigProblemOptions options = Ordinary(0, 0.3);
  options.baseline_m = 0.0;
  options.odometry_noise_m = 0.0;
  EXPECT_TRUE(EstimateRigHypotheses(MakeRigProblem(options).rigs, {}, 0).empty());
}

TEST(EstimateRigHypotheses, OnlyWrongMatchesEndInFewInliers) {
  const RigProblem problem = MakeRigProblem(Ordinary(1, 1.0));
  for (const RigHypothesis& h : EstimateRigHypotheses(problem.rigs, {}, 1)) {
    EXPECT_LT(h.num_inliers, 100);  // of 900
  }
}

TEST(EstimateRigHypotheses, MalformedInputIsRefused) {
  RigProblem problem = MakeRigProblem({});
  problem.rigs.pairs[0].cand[0].z() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(EstimateRigHypotheses(problem.rigs, {}, 0), std::invalid_argument);
  const RigPairs rigs = MakeRigProblem({}).rigs;
  const auto with = [&](auto set) {
    RigHypothesisOptions options;
    set(options);
    EXPECT_THROW(EstimateRigHypotheses(rigs, options, 0), std::invalid_argument);
  };
  with([](RigHypothesisOptions& o) { o.max_error_px = 0.0; });
  with([](RigHypothesisOptions& o) { o.confidence = 1.0; });
  with([](RigHypothesisOptions& o) { o.min_num_iterations = 2000; });
  with([](RigHypothesisOptions& o) { o.num_scale_rays = 0; });
  with([](RigHypothesisOptions& o) { o.max_num_hypotheses = 0; });
  with([](RigHypothesisOptions& o) { o.min_num_inliers = 5; });
  with([](RigHypothesisOptions& o) { o.max_same_distance_m = -1.0; });
  with([](RigHypothesisOptions& o) { o.min_same_overlap = 2.0; });
  with([](RigHypothesisOptions& o) {
    o.verticals = Verticals{Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitZ()};
  });
  with([](RigHypothesisOptions& o) { o.vertical_sigma_rad = -0.1; });
}

}  // namespace
}  // namespace covinz
