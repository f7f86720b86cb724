// Two-view geometry and the five-point RANSAC on generated views with ground truth.
#include "covinz/relative_pose.h"

#include <cmath>

#include <gtest/gtest.h>

#include "rig_problem.h"

namespace covinz {
namespace {

RigProblem TwoViews(RigProblemOptions options) {
  options.num_query_cams = 1;
  options.num_cand_cams = 1;
  return MakeRigProblem(options);
}

double DirectionError_rad(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  return std::acos(std::min(1.0, a.translation().normalized().dot(b.translation().normalized())));
}

TEST(Epipolar, ErrorIsTheDistanceInPixels) {
  const RigProblem problem = TwoViews({});
  BearingPairs pairs = problem.rigs.pairs[0];
  const Eigen::Matrix3d E = EssentialMatrix(problem.T_cand_query);
  EXPECT_LT(SquaredSampsonError_px2(E, pairs, 0), 1e-18);
  // One pixel across the epipolar plane, in the candidate only: the cheapest correction shares it
  // among both views, so the distance is below one pixel; with a far sharper query camera it is
  // one.
  const Eigen::Vector3d normal = (E * pairs.query[0]).normalized();
  pairs.cand[0] = (pairs.cand[0] + normal / pairs.cand_focal_px).normalized();
  const double shared_px = std::sqrt(SquaredSampsonError_px2(E, pairs, 0));
  EXPECT_GT(shared_px, 0.5);
  EXPECT_LT(shared_px, 0.95);
  pairs.query_focal_px = 1e6;
  EXPECT_NEAR(std::sqrt(SquaredSampsonError_px2(E, pairs, 0)), 1.0, 1e-3);
}

TEST(Epipolar, NoBaselineHasNoError) {
  const RigProblem problem = TwoViews({});
  const Eigen::Matrix3d E = EssentialMatrix(Eigen::Isometry3d::Identity());
  EXPECT_TRUE(std::isnan(SquaredSampsonError_px2(E, problem.rigs.pairs[0], 0)));
  EXPECT_TRUE(FindInliers(Eigen::Isometry3d::Identity(), problem.rigs.pairs[0], 2.0).empty());
}

TEST(Epipolar, BehindIsNoInlier) {
  const RigProblem problem = TwoViews({});
  const BearingPairs& pairs = problem.rigs.pairs[0];
  EXPECT_EQ(FindInliers(problem.T_cand_query, pairs, 0.1).size(), pairs.size());
  // The mirrored baseline fits all epipolar planes but puts the points behind.
  Eigen::Isometry3d mirrored = problem.T_cand_query;
  mirrored.translation() *= -1.0;
  EXPECT_TRUE(FindInliers(mirrored, pairs, 0.1).empty());
}

TEST(Epipolar, PointsAtInfinityAreInFront) {
  RigProblemOptions options;
  options.min_depth_m = 1e5;
  options.max_depth_m = 2e5;
  options.noise_px = 0.5;
  const RigProblem problem = TwoViews(options);
  const BearingPairs& pairs = problem.rigs.pairs[0];
  for (size_t i = 0; i < pairs.size(); ++i) {
    EXPECT_TRUE(InFrontOfBoth(problem.T_cand_query, pairs, i, 3.0));
  }
}

TEST(EstimateRelativePose, ExactWithoutNoise) {
  for (uint64_t seed = 0; seed < 20; ++seed) {
    RigProblemOptions options;
    options.seed = seed;
    const RigProblem problem = TwoViews(options);
    RelativePoseOptions ransac;
    ransac.max_error_px = 0.001;
    const auto pose = EstimateRelativePose(problem.rigs.pairs[0], ransac, seed);
    ASSERT_TRUE(pose);
    EXPECT_NEAR(pose->T_cand_query.translation().norm(), 1.0, 1e-9);
    EXPECT_LT(DirectionError_rad(pose->T_cand_query, problem.T_cand_query), 1e-4);
    EXPECT_LT(PoseError(problem.T_cand_query, pose->T_cand_query).head<3>().norm(), 1e-5);
    EXPECT_EQ(pose->inliers.size(), 150u);
  }
}

TEST(EstimateRelativePose, SeparatesOutliers) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    RigProblemOptions options;
    options.seed = seed;
    options.noise_px = 0.5;
    options.outlier_ratio = 0.5;
    options.num_points = 300;
    const RigProblem problem = TwoViews(options);
    const BearingPairs& pairs = problem.rigs.pairs[0];
    const auto pose = EstimateRelativePose(pairs, {}, seed);
    ASSERT_TRUE(pose);
    // Against what the true pose would call inliers.
    const size_t num_true = FindInliers(problem.T_cand_query, pairs, 2.0).size();
    EXPECT_GT(pose->inliers.size(), 0.85 * static_cast<double>(num_true));
    EXPECT_LT(PoseError(problem.T_cand_query, pose->T_cand_query).head<3>().norm(), 0.05);
    EXPECT_TRUE(std::is_sorted(pose->inliers.begin(), pose->inliers.end()));
  }
}

TEST(EstimateRelativePose, NoConsensusInNoise) {
  RigProblemOptions options;
  options.outlier_ratio = 1.0;
  options.num_points = 100;
  const RigProblem problem = TwoViews(options);
  const auto pose = EstimateRelativePose(problem.rigs.pairs[0], {}, 1);
  EXPECT_LT(pose ? pose->inliers.size() : 0u, 30u);  // the paper's threshold
}

TEST(EstimateRelativePose, SameSeedSameBits) {
  RigProblemOptions options;
  options.noise_px = 1.0;
  options.outlier_ratio = 0.3;
  const RigProblem problem = TwoViews(options);
  const auto a = EstimateRelativePose(problem.rigs.pairs[0], {}, 7);
  const auto b = EstimateRelativePose(problem.rigs.pairs[0], {}, 7);
  const auto c = EstimateRelativePose(problem.rigs.pairs[0], {}, 8);
  ASSERT_TRUE(a && b && c);
  EXPECT_EQ(a->T_cand_query.matrix(), b->T_cand_query.matrix());
  EXPECT_EQ(a->inliers, b->inliers);
  EXPECT_NE(a->T_cand_query.matrix(), c->T_cand_query.matrix());
}

TEST(EstimateRelativePose, TooFewAndMalformed) {
  RigProblemOptions options;
  options.num_points = 4;
  EXPECT_FALSE(EstimateRelativePose(TwoViews(options).rigs.pairs[0], {}, 1));
  BearingPairs pairs = TwoViews({}).rigs.pairs[0];
  pairs.query[3] *= 2.0;
  EXPECT_THROW(EstimateRelativePose(pairs, {}, 1), std::invalid_argument);
  pairs = TwoViews({}).rigs.pairs[0];
  pairs.cand.pop_back();
  EXPECT_THROW(EstimateRelativePose(pairs, {}, 1), std::invalid_argument);
  pairs = TwoViews({}).rigs.pairs[0];
  pairs.cand[0].setConstant(std::nan(""));
  EXPECT_THROW(EstimateRelativePose(pairs, {}, 1), std::invalid_argument);
  pairs = TwoViews({}).rigs.pairs[0];
  pairs.query_focal_px = 0.0;
  EXPECT_THROW(EstimateRelativePose(pairs, {}, 1), std::invalid_argument);
}

TEST(RelativePoseOptions, Check) {
  RelativePoseOptions options;
  EXPECT_NO_THROW(options.Check());
  options.max_error_px = 0.0;
  EXPECT_THROW(options.Check(), std::invalid_argument);
  options = {};
  options.confidence = 1.0;
  EXPECT_THROW(options.Check(), std::invalid_argument);
  options = {};
  options.max_num_iterations = 0;
  EXPECT_THROW(options.Check(), std::invalid_argument);
}

TEST(NumRansacIterations, KnownValues) {
  // ln(0.01) / ln(1 - 0.5^5) = 145.05
  EXPECT_EQ(NumRansacIterations(std::pow(0.5, 5), 0.99, 1000), 146);
  EXPECT_EQ(NumRansacIterations(std::pow(0.5, 5), 0.99, 100), 100);
  EXPECT_EQ(NumRansacIterations(1.0, 0.99, 100), 1);
  EXPECT_EQ(NumRansacIterations(0.0, 0.99, 100), 100);
  EXPECT_EQ(NumRansacIterations(1e-300, 0.99, 100), 100);
}

}  // namespace
}  // namespace covinz
