// The vectorised Sampson errors against epipolar.h, their Jacobian against differences, and the
// instruction sets against one another.
#include "covinz/rig_sampson.h"

#include <cmath>

#include <gtest/gtest.h>

#include "rig_problem.h"

namespace covinz {
namespace {

constexpr double kMaxErrorPx = 2.0;

RigProblem NoisyProblem(uint64_t seed) {
  RigProblemOptions options;
  options.noise_px = 1.0;
  options.outlier_ratio = 0.3;
  options.odometry_noise_m = 0.006;
  options.odometry_noise_rad = 0.002;
  options.num_points = 101;  // not a multiple of the lanes
  options.seed = seed;
  return MakeRigProblem(options);
}

std::vector<InstructionSet> Supported() {
  std::vector<InstructionSet> supported;
  for (const InstructionSet set :
       {InstructionSet::kPortable, InstructionSet::kAvx2, InstructionSet::kAvx512}) {
    if (IsSupported(set)) supported.push_back(set);
  }
  return supported;
}

Eigen::Isometry3d CameraPose(const RigPairs& rigs, size_t p, const Eigen::Isometry3d& T) {
  return rigs.T_cand_cam[size_t(rigs.pairs[p].cand_cam)].inverse() * T *
         rigs.T_query_cam[size_t(rigs.pairs[p].query_cam)];
}

// The biweight cost by the scalar functions, with the inliers of one pose.
double Cost(const RigPairs& rigs,
            const Eigen::Isometry3d& T,
            const std::vector<std::vector<int>>& inliers,
            double max_error_px) {
  const double k2 = max_error_px * max_error_px;
  double cost = static_cast<double>(rigs.NumMatches()) * k2 / 3.0;
  for (size_t p = 0; p < rigs.pairs.size(); ++p) {
    const Eigen::Matrix3d E = EssentialMatrix(CameraPose(rigs, p, T));
    for (const int i : inliers[p]) {
      const double rest = 1.0 - SquaredSampsonError_px2(E, rigs.pairs[p], size_t(i)) / k2;
      cost -= k2 / 3.0 * rest * rest * rest;
    }
  }
  return cost;
}

TEST(RigSampson, InliersAreThoseOfTheScalarFunctions) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    const RigProblem problem = NoisyProblem(seed);
    const auto inliers = RigSampson(problem.rigs).Inliers(problem.T_cand_query, kMaxErrorPx);
    double gain = 0.0;
    int num_inliers = 0;
    for (size_t p = 0; p < problem.rigs.pairs.size(); ++p) {
      const Eigen::Isometry3d T = CameraPose(problem.rigs, p, problem.T_cand_query);
      EXPECT_EQ(inliers[p], FindInliers(T, problem.rigs.pairs[p], kMaxErrorPx));
      num_inliers += static_cast<int>(inliers[p].size());
      for (const int i : inliers[p]) {
        gain += kMaxErrorPx * kMaxErrorPx -
                SquaredSampsonError_px2(EssentialMatrix(T), problem.rigs.pairs[p], size_t(i));
      }
    }
    const RigScore score = RigSampson(problem.rigs).Score(problem.T_cand_query, kMaxErrorPx);
    EXPECT_EQ(score.num_inliers, num_inliers);
    EXPECT_NEAR(score.gain, gain, 1e-4 * gain);
  }
}

TEST(RigSampson, GradientIsThatOfTheCost) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    const RigProblem problem = NoisyProblem(seed);
    const RigSampson sampson(problem.rigs);
    std::mt19937_64 engine(seed);
    // Off the optimum, where the derivative of the denominator is a tenth of the whole.
    const Eigen::Isometry3d T = problem.T_cand_query * RandomPose(engine, 0.02, 0.1);
    const double max_error_px = 15.0;
    const auto inliers = sampson.Inliers(T, max_error_px);
    const SampsonSystem system = sampson.Linearize(T, max_error_px);
    EXPECT_NEAR(system.cost, Cost(problem.rigs, T, inliers, max_error_px), 1e-4 * system.cost);
    for (int k = 0; k < 6; ++k) {
      const Vector6d step = 1e-6 * Vector6d::Unit(k);
      const double numeric = (Cost(problem.rigs, T * ExpSE3(step), inliers, max_error_px) -
                              Cost(problem.rigs, T * ExpSE3(-step), inliers, max_error_px)) /
                             2e-6;
      EXPECT_NEAR(2.0 * system.Jte[k], numeric, 1e-4 * system.Jte.norm());
    }
  }
}

// A single match, so that JtJ is one squared row of the Jacobian.
TEST(RigSampson, JacobianIsThatOfTheError) {
  RigProblemOptions options;
  options.num_points = 1;
  options.num_query_cams = 2;
  options.num_cand_cams = 1;
  options.noise_px = 3.0;
  const double max_error_px = 50.0;
  for (uint64_t seed = 0; seed < 50; ++seed) {
    options.seed = seed;
    RigProblem problem = MakeRigProblem(options);
    problem.rigs.pairs.erase(problem.rigs.pairs.begin());
    problem.rigs.pairs[0].query_focal_px = 300.0;
    std::mt19937_64 engine(seed);
    const Eigen::Isometry3d T = problem.T_cand_query * RandomPose(engine, 0.01, 0.05);
    const auto error_px = [&](const Vector6d& xi) {
      const Eigen::Isometry3d T_cams = CameraPose(problem.rigs, 0, T * ExpSE3(xi));
      const Eigen::Matrix3d E = EssentialMatrix(T_cams);
      const double e = problem.rigs.pairs[0].cand[0].dot(E * problem.rigs.pairs[0].query[0]);
      return std::copysign(std::sqrt(SquaredSampsonError_px2(E, problem.rigs.pairs[0], 0)), e);
    };
    const SampsonSystem system = RigSampson(problem.rigs).Linearize(T, max_error_px);
    ASSERT_EQ(system.num_inliers, 1);
    const double error = error_px(Vector6d::Zero());
    const double rest = 1.0 - error * error / (max_error_px * max_error_px);
    Vector6d J;
    for (int k = 0; k < 6; ++k) {
      const Vector6d step = 1e-6 * Vector6d::Unit(k);
      J[k] = (error_px(step) - error_px(-step)) / 2e-6;
    }
    EXPECT_TRUE(system.JtJ.isApprox(rest * rest * J * J.transpose(), 1e-3));
    EXPECT_TRUE(system.Jte.isApprox(rest * rest * error * J, 1e-3));
  }
}

TEST(RigSampson, AllInstructionSetsGiveTheSameBits) {
  for (uint64_t seed = 0; seed < 5; ++seed) {
    const RigProblem problem = NoisyProblem(seed);
    const RigSampson portable(problem.rigs, InstructionSet::kPortable);
    const Eigen::Isometry3d& T = problem.T_cand_query;
    for (const InstructionSet set : Supported()) {
      const RigSampson other(problem.rigs, set);
      EXPECT_EQ(portable.Score(T, 3.0).gain, other.Score(T, 3.0).gain);
      EXPECT_EQ(portable.Inliers(T, 3.0), other.Inliers(T, 3.0));
      const SampsonSystem a = portable.Linearize(T, 3.0);
      const SampsonSystem b = other.Linearize(T, 3.0);
      EXPECT_EQ(a.JtJ, b.JtJ);
      EXPECT_EQ(a.Jte, b.Jte);
      EXPECT_EQ(a.cost, b.cost);
    }
  }
}

TEST(RigSampson, NoBaselineNoInliers) {
  RigProblemOptions options;
  options.num_query_cams = options.num_cand_cams = 1;
  const RigProblem problem = MakeRigProblem(options);
  const Eigen::Isometry3d same = Eigen::Isometry3d::Identity();
  EXPECT_EQ(RigSampson(problem.rigs).Score(same, 2.0).num_inliers, 0);
  const SampsonSystem system = RigSampson(problem.rigs).Linearize(same, 2.0);
  EXPECT_EQ(system.JtJ, Matrix6d::Zero());
}

TEST(RigSampson, MalformedPairsAreRefused) {
  RigProblem problem = MakeRigProblem({});
  problem.rigs.pairs[2].query[1].x() = NAN;
  EXPECT_THROW(RigSampson{problem.rigs}, std::invalid_argument);
  RigProblem other = MakeRigProblem({});
  other.rigs.pairs[0].cand_cam = 3;
  EXPECT_THROW(RigSampson{other.rigs}, std::invalid_argument);
}

}  // namespace
}  // namespace covinz
