// 17-point RANSAC, its covariance and the scale test on generated rigs with ground truth.
#include "covinz/rig_relative_pose.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>

#include "covinz/rig_scale.h"
#include "rig_problem.h"

namespace covinz {
namespace {

// What an ordinary hand-held run gives: 0.7 px, 6 mm and 0.11 degrees between keyframes.
RigProblemOptions Ordinary(uint64_t seed) {
  RigProblemOptions options;
  options.noise_px = 0.7;
  options.odometry_noise_m = 0.006;
  options.odometry_noise_rad = 0.002;
  options.seed = seed;
  return options;
}

double Median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<long>(values.size() / 2),
                   values.end());
  return values.at(values.size() / 2);
}

double Nees(const Vector6d& error, const Matrix6d& covariance) {
  return error.dot(covariance.ldlt().solve(error));
}

class RigSizes : public testing::TestWithParam<std::array<int, 2>> {};

TEST_P(RigSizes, ExactWithoutNoise) {
  for (uint64_t seed = 0; seed < 5; ++seed) {
    RigProblemOptions options;
    options.num_query_cams = GetParam()[0];
    options.num_cand_cams = GetParam()[1];
    options.seed = seed;
    const RigProblem problem = MakeRigProblem(options);
    const auto pose = EstimateRigRelativePose(problem.rigs, {}, seed);
    ASSERT_TRUE(pose);
    EXPECT_LT(PoseError(problem.T_cand_query, pose->T_cand_query).norm(), 1e-5);
    EXPECT_EQ(pose->num_inliers, static_cast<int>(problem.rigs.NumMatches()));
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes,
                         RigSizes,
                         testing::Values(std::array{2, 3},
                                         std::array{3, 2},
                                         std::array{2, 2},
                                         std::array{1, 3},
                                         std::array{3, 1},
                                         std::array{1, 2},
                                         std::array{5, 5}));  // more pairs than a sample has rays

TEST(EstimateRigRelativePose, AccuracyBands) {
  std::vector<double> translation_m, rotation_rad;
  for (uint64_t seed = 0; seed < 60; ++seed) {
    const RigProblem problem = MakeRigProblem(Ordinary(seed));
    const auto pose = EstimateRigRelativePose(problem.rigs, {}, seed);
    ASSERT_TRUE(pose);
    const Vector6d error = PoseError(problem.T_cand_query, pose->T_cand_query);
    rotation_rad.push_back(error.head<3>().norm());
    translation_m.push_back(error.tail<3>().norm());
  }
  EXPECT_LT(Median(translation_m), 0.06);
  EXPECT_LT(Median(rotation_rad), 0.015);
}

TEST(EstimateRigRelativePose, SurvivesOutliers) {
  std::vector<double> translation_m;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    RigProblemOptions options = Ordinary(seed);
    options.outlier_ratio = 0.1;
    const RigProblem problem = MakeRigProblem(options);
    const auto pose = EstimateRigRelativePose(problem.rigs, {}, seed);
    ASSERT_TRUE(pose);
    translation_m.push_back(PoseError(problem.T_cand_query, pose->T_cand_query).tail<3>().norm());
    EXPECT_GT(pose->num_iterations, 10);
  }
  EXPECT_LT(Median(translation_m), 0.06);
}

TEST(EstimateRigRelativePose, SameSeedSameBits) {
  const RigProblem problem = MakeRigProblem(Ordinary(3));
  const auto a = EstimateRigRelativePose(problem.rigs, {}, 5);
  const auto b = EstimateRigRelativePose(problem.rigs, {}, 5);
  const auto c = EstimateRigRelativePose(problem.rigs, {}, 6);
  ASSERT_TRUE(a && b && c);
  EXPECT_EQ(a->T_cand_query.matrix(), b->T_cand_query.matrix());
  EXPECT_EQ(a->inliers, b->inliers);
  EXPECT_NE(a->T_cand_query.matrix(), c->T_cand_query.matrix());
  EXPECT_EQ(SampleRigCovariance(problem.rigs, *a, {}, 5).covariance,
            SampleRigCovariance(problem.rigs, *b, {}, 5).covariance);
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

TEST(EstimateRigRelativePose, SwapGivesTheInverse) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    RigProblemOptions options;
    options.seed = seed;
    const RigProblem problem = MakeRigProblem(options);
    const auto pose = EstimateRigRelativePose(problem.rigs, {}, seed);
    const auto swapped = EstimateRigRelativePose(Swapped(problem.rigs), {}, seed);
    ASSERT_TRUE(pose && swapped);
    EXPECT_LT(PoseError(pose->T_cand_query, swapped->T_cand_query.inverse()).norm(), 1e-5);
  }
}

// The same cameras as seen from other bodies: p_new = T_new_old p_old on both sides.
RigPairs WithOtherBodies(const RigPairs& rigs, const Eigen::Isometry3d& T_new_old) {
  RigPairs moved = rigs;
  for (Eigen::Isometry3d& T : moved.T_query_cam) T = T_new_old * T;
  for (Eigen::Isometry3d& T : moved.T_cand_cam) T = T_new_old * T;
  return moved;
}

TEST(EstimateRigRelativePose, BodyFramesDoNotMatter) {
  // Straight motion with the camera off the body is where they would.
  for (const bool straight : {false, true}) {
    for (uint64_t seed = 0; seed < 10; ++seed) {
      RigProblemOptions options = Ordinary(seed);
      options.straight = straight;
      const RigProblem problem = MakeRigProblem(options);
      std::mt19937_64 engine(seed);
      const Eigen::Isometry3d T_new_old = RandomPose(engine, 1.0, 0.3);
      const RigPairs moved = WithOtherBodies(problem.rigs, T_new_old);
      const auto pose = EstimateRigRelativePose(problem.rigs, {}, seed);
      const auto other = EstimateRigRelativePose(moved, {}, seed);
      ASSERT_TRUE(pose && other);
      EXPECT_LT(PoseError(pose->T_cand_query, T_new_old.inverse() * other->T_cand_query * T_new_old)
                    .norm(),
                1e-6);
    }
  }
}

TEST(EstimateRigRelativePose, StraightMotion) {
  // Both rigs on lines: the linear equations alone do not fix the rotation.
  std::vector<double> translation_m;
  for (uint64_t seed = 0; seed < 40; ++seed) {
    RigProblemOptions options = Ordinary(seed);
    options.straight = true;
    const RigProblem problem = MakeRigProblem(options);
    const auto pose = EstimateRigRelativePose(problem.rigs, {}, seed);
    ASSERT_TRUE(pose);
    EXPECT_EQ(SampleRigCovariance(problem.rigs, *pose, {}, seed).num_samples, 30);
    translation_m.push_back(PoseError(problem.T_cand_query, pose->T_cand_query).tail<3>().norm());
  }
  EXPECT_LT(Median(translation_m), 0.06);
}

TEST(EstimateRigRelativePose, LoopWithoutAnyMotion) {
  // Both rigs at one place: E = [t]R vanishes there.
  for (uint64_t seed = 0; seed < 10; ++seed) {
    RigProblemOptions options = Ordinary(seed);
    options.loop_distance_m = 0.0;
    options.loop_turn_rad = 0.0;
    const RigProblem problem = MakeRigProblem(options);
    const auto pose = EstimateRigRelativePose(problem.rigs, {}, seed);
    ASSERT_TRUE(pose);
    EXPECT_LT(PoseError(problem.T_cand_query, pose->T_cand_query).norm(), 0.2);
  }
}

TEST(EstimateRigRelativePose, TooFewAndMalformed) {
  RigProblemOptions options;
  options.num_points = 2;  // 12 matches
  EXPECT_FALSE(EstimateRigRelativePose(MakeRigProblem(options).rigs, {}, 1));
  EXPECT_FALSE(EstimateRigRelativePose(RigPairs{}, {}, 1));
  RigProblem problem = MakeRigProblem({});
  problem.rigs.pairs[0].query_cam = 2;
  EXPECT_THROW(EstimateRigRelativePose(problem.rigs, {}, 1), std::invalid_argument);
}

TEST(EstimateRigRelativePose, APairMayBeEmpty) {
  RigProblem problem = MakeRigProblem({});
  problem.rigs.pairs[2].query.clear();
  problem.rigs.pairs[2].cand.clear();
  const auto pose = EstimateRigRelativePose(problem.rigs, {}, 1);
  ASSERT_TRUE(pose);
  EXPECT_LT(PoseError(problem.T_cand_query, pose->T_cand_query).norm(), 1e-5);
}

TEST(SampleRigCovariance, NeesBand) {
  // Ideal 6; minimal samples are worse than the best of them, which RANSAC returns.
  double sum = 0.0;
  const int num_problems = 60;
  for (uint64_t seed = 0; seed < num_problems; ++seed) {
    const RigProblem problem = MakeRigProblem(Ordinary(seed));
    const auto pose = EstimateRigRelativePose(problem.rigs, {}, seed);
    ASSERT_TRUE(pose);
    const RigCovariance sampled = SampleRigCovariance(problem.rigs, *pose, {}, seed);
    ASSERT_EQ(sampled.num_samples, 30);
    const double nees =
        Nees(PoseError(problem.T_cand_query, pose->T_cand_query), sampled.covariance);
    EXPECT_LT(nees, 40.0);
    sum += nees;
  }
  EXPECT_GT(sum / num_problems, 0.3);
  EXPECT_LT(sum / num_problems, 8.0);
}

TEST(SampleRigCovariance, PositiveDefiniteWithoutNoise) {
  const RigProblem problem = MakeRigProblem({});
  const auto pose = EstimateRigRelativePose(problem.rigs, {}, 1);
  ASSERT_TRUE(pose);
  const Matrix6d covariance = SampleRigCovariance(problem.rigs, *pose, {}, 1).covariance;
  EXPECT_EQ(covariance, covariance.transpose());
  EXPECT_EQ(covariance.llt().info(), Eigen::Success);
  EXPECT_NEAR(std::sqrt(covariance(0, 0)), RigCovarianceOptions{}.min_sigma_rotation_rad, 1e-4);
  EXPECT_NEAR(std::sqrt(covariance(5, 5)), RigCovarianceOptions{}.min_sigma_translation_m, 1e-4);
}

TEST(SampleRigCovariance, LivesInTheQueryBodyFrame) {
  // Other bodies, same cameras: the adjoint carries one covariance to the other.
  const RigProblem problem = MakeRigProblem(Ordinary(4));
  std::mt19937_64 engine(4);
  const Eigen::Isometry3d T_new_old = RandomPose(engine, 1.0, 0.3);
  const auto pose = EstimateRigRelativePose(problem.rigs, {}, 1);
  ASSERT_TRUE(pose);
  RigRelativePose other = *pose;
  other.T_cand_query = T_new_old * pose->T_cand_query * T_new_old.inverse();
  RigCovarianceOptions bare;
  bare.min_sigma_rotation_rad = 1e-9;
  bare.min_sigma_translation_m = 1e-9;
  const Matrix6d old_body = SampleRigCovariance(problem.rigs, *pose, bare, 1).covariance;
  const Matrix6d new_body =
      SampleRigCovariance(WithOtherBodies(problem.rigs, T_new_old), other, bare, 1).covariance;
  const Matrix6d Ad = AdjointSE3(T_new_old);
  // Not exactly: the chart is first order and samples scatter by degrees.
  EXPECT_LT((new_body - Ad * old_body * Ad.transpose()).norm(), 0.02 * new_body.norm());
  EXPECT_GT((new_body - old_body).norm(), 0.2 * new_body.norm());
}

TEST(SampleRigCovariance, SaysWhenSamplesAreBad) {
  const RigProblem problem = MakeRigProblem(Ordinary(1));
  const auto pose = EstimateRigRelativePose(problem.rigs, {}, 1);
  ASSERT_TRUE(pose);
  RigCovarianceOptions strict;
  strict.max_error_px = 0.1;
  EXPECT_LT(SampleRigCovariance(problem.rigs, *pose, strict, 1).num_samples, 30);
}

double CommonCentreRatioOf(const RigProblemOptions& options, uint64_t seed) {
  const RigProblem problem = MakeRigProblem(options);
  const auto pose = EstimateRigRelativePose(problem.rigs, {}, seed);
  return pose ? CommonCentreRatio(problem.rigs, *pose, {}, seed) : 1.0;
}

TEST(CommonCentreRatio, LowForOrdinaryRigs) {
  for (uint64_t seed = 0; seed < 20; ++seed) {
    EXPECT_LT(CommonCentreRatioOf(Ordinary(seed), seed), 0.6);
  }
}

TEST(CommonCentreRatio, HighWhereScaleDoesNotShow) {
  std::vector<double> only_turning, far_away;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    RigProblemOptions options = Ordinary(seed);
    options.odometry_noise_rad = 0.0005;
    options.baseline_m = 0.0;  // all that the rig's baselines say is odometry noise
    only_turning.push_back(CommonCentreRatioOf(options, seed));
    options = Ordinary(seed);
    options.min_depth_m = 200.0;
    options.max_depth_m = 600.0;
    far_away.push_back(CommonCentreRatioOf(options, seed));
  }
  EXPECT_GT(Median(only_turning), 0.9);
  EXPECT_GT(Median(far_away), 0.9);
  EXPECT_GT(*std::min_element(far_away.begin(), far_away.end()), 0.8);
}

TEST(CommonCentreRatio, OneForMatchesOfASinglePair) {
  RigProblem problem = MakeRigProblem({});
  for (size_t p = 1; p < problem.rigs.pairs.size(); ++p) {
    problem.rigs.pairs[p].query.clear();
    problem.rigs.pairs[p].cand.clear();
  }
  RigRelativePose estimate{problem.T_cand_query, {}, 150, 1};
  estimate.inliers.resize(6);
  for (int i = 0; i < 150; ++i) estimate.inliers[0].push_back(i);
  EXPECT_EQ(CommonCentreRatio(problem.rigs, estimate, {}, 1), 1.0);
}

TEST(RigOptions, Check) {
  EXPECT_NO_THROW(RigRelativePoseOptions{}.Check());
  EXPECT_NO_THROW(RigCovarianceOptions{}.Check());
  EXPECT_NO_THROW(RigScaleOptions{}.Check());
  const auto throws = [](auto options, auto member, double value) {
    using Value = std::remove_reference_t<decltype(options.*member)>;
    options.*member = static_cast<Value>(value);
    EXPECT_THROW(options.Check(), std::invalid_argument);
  };
  throws(RigRelativePoseOptions{}, &RigRelativePoseOptions::max_error_px, 0.0);
  throws(RigRelativePoseOptions{}, &RigRelativePoseOptions::confidence, 1.0);
  throws(RigRelativePoseOptions{}, &RigRelativePoseOptions::max_num_iterations, 0);
  throws(RigCovarianceOptions{}, &RigCovarianceOptions::num_samples, 6);
  throws(RigCovarianceOptions{}, &RigCovarianceOptions::max_num_tries, 29);
  throws(RigCovarianceOptions{}, &RigCovarianceOptions::min_inlier_ratio, 1.1);
  throws(RigCovarianceOptions{}, &RigCovarianceOptions::max_error_px, NAN);
  throws(RigCovarianceOptions{}, &RigCovarianceOptions::min_sigma_rotation_rad, 0.0);
  throws(RigCovarianceOptions{}, &RigCovarianceOptions::min_sigma_translation_m, -1.0);
  throws(RigScaleOptions{}, &RigScaleOptions::max_common_centre_ratio, 0.0);
  throws(RigScaleOptions{}, &RigScaleOptions::max_error_px, 0.0);
  throws(RigScaleOptions{}, &RigScaleOptions::max_num_iterations, 0);
}

}  // namespace
}  // namespace covinz
