// The five-point and the 5+1-point solver on exact rays.
#include "covinz/generalized_relative_pose.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "covinz/five_point.h"
#include "covinz/polynomial.h"
#include "covinz/random.h"
#include "rig_problem.h"

namespace covinz {
namespace {

constexpr double kParallelRad = 1e-6;

std::array<RayMatch, 6> DrawSample(const RigPairs& rigs, uint64_t seed) {
  Random random(seed);
  const size_t five = static_cast<size_t>(random.Below(static_cast<int>(rigs.pairs.size())));
  const size_t one = (five + 1) % rigs.pairs.size();
  std::vector<int> rows;
  random.DrawDistinct(0, static_cast<int>(rigs.pairs[five].size()), 5, rows);
  random.DrawDistinct(0, static_cast<int>(rigs.pairs[one].size()), 1, rows);
  std::array<RayMatch, 6> sample;
  for (size_t i = 0; i < 6; ++i) {
    sample[i] = RayMatchOf(rigs, i < 5 ? five : one, static_cast<size_t>(rows[i]));
  }
  return sample;
}

TEST(RealRoots, AreThoseOfTheFactors) {
  // (x - 0.5)(x + 3)(x - 20)(x^2 + 1), expanded.
  const std::vector<double> coefficients{30.0, -51.5, 12.5, -50.5, -17.5, 1.0};
  std::vector<double> roots = RealRoots(coefficients);
  std::sort(roots.begin(), roots.end());
  ASSERT_EQ(roots.size(), 3u);
  EXPECT_NEAR(roots[0], -3.0, 1e-12);
  EXPECT_NEAR(roots[1], 0.5, 1e-12);
  EXPECT_NEAR(roots[2], 20.0, 1e-11);
}

TEST(RealRoots, RandomTenthDegree) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal;
  for (int k = 0; k < 200; ++k) {
    // Four known roots times a positive sextic.
    std::vector<double> wanted;
    std::vector<double> p{1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0};
    for (int i = 0; i < 4; ++i) {
      wanted.push_back(normal(engine) / normal(engine));
      std::vector<double> product(p.size() + 1, 0.0);
      for (size_t j = 0; j < p.size(); ++j) {
        product[j + 1] += p[j];
        product[j] -= wanted.back() * p[j];
      }
      p = product;
    }
    const std::vector<double> roots = RealRoots(p);
    EXPECT_EQ(roots.size(), 4u);
    for (const double root : wanted) {
      double nearest = 1e300;
      for (const double found : roots) nearest = std::min(nearest, std::abs(found - root));
      EXPECT_LT(nearest, 1e-6 * (1.0 + std::abs(root)));
    }
  }
}

TEST(RealRoots, NoneWhereThereAreNone) {
  EXPECT_TRUE(RealRoots({}).empty());
  EXPECT_TRUE(RealRoots({1.0}).empty());
  EXPECT_TRUE(RealRoots({1.0, 0.0, 1.0}).empty());
  EXPECT_TRUE(RealRoots({0.0, 0.0, 0.0}).empty());
  EXPECT_TRUE(RealRoots({1.0, NAN, 1.0}).empty());
  EXPECT_EQ(RealRoots({-1.0, 2.0, 0.0, 0.0}).size(), 1u);  // leading zeros
}

TEST(FivePointEssentialMatrices, ExactOnExactRays) {
  int found = 0;
  for (uint64_t seed = 0; seed < 500; ++seed) {
    RigProblemOptions options;
    options.num_query_cams = 1;
    options.num_cand_cams = 1;
    options.num_points = 5;
    options.seed = seed;
    const RigProblem problem = MakeRigProblem(options);
    std::array<Eigen::Vector3d, 5> query, cand;
    for (size_t i = 0; i < 5; ++i) {
      query[i] = problem.rigs.pairs[0].query[i];
      cand[i] = problem.rigs.pairs[0].cand[i];
    }
    const Eigen::Matrix3d E_true = EssentialMatrix(problem.T_cand_query).normalized();
    double nearest = 1.0;
    for (const Eigen::Matrix3d& E : FivePointEssentialMatrices(query, cand)) {
      EXPECT_NEAR(E.norm(), 1.0, 1e-12);
      for (size_t i = 0; i < 5; ++i) EXPECT_LT(std::abs(cand[i].dot(E * query[i])), 1e-10);
      nearest = std::min({nearest, (E - E_true).norm(), (E + E_true).norm()});
    }
    found += nearest < 1e-5;
  }
  // A sample can be near a double root, where half of the digits are lost.
  EXPECT_GE(found, 495);
}

TEST(FivePointEssentialMatrices, DegenerateRaysDoNoHarm) {
  std::array<Eigen::Vector3d, 5> same;
  same.fill(Eigen::Vector3d::UnitZ());
  for (const Eigen::Matrix3d& E : FivePointEssentialMatrices(same, same)) {
    EXPECT_TRUE(E.allFinite());
  }
  std::array<Eigen::Vector3d, 5> none;
  none.fill(Eigen::Vector3d::Constant(NAN));
  EXPECT_TRUE(FivePointEssentialMatrices(none, none).empty());
}

TEST(SolveFivePlusOne, TheTruthIsAmongTheSolutions) {
  int found = 0, num_inexact = 0;
  for (uint64_t seed = 0; seed < 500; ++seed) {
    RigProblemOptions options;
    options.seed = seed;
    const RigProblem problem = MakeRigProblem(options);
    double nearest = 1e300;
    const std::array<RayMatch, 6> sample = DrawSample(problem.rigs, seed);
    for (const Eigen::Isometry3d& T : SolveFivePlusOne(sample, kParallelRad)) {
      EXPECT_TRUE(T.linear().isUnitary(1e-9));
      nearest = std::min(nearest, PoseError(problem.T_cand_query, T).norm());
      for (const RayMatch& match : sample) {
        const Eigen::Vector3d baseline = T * match.query_centre - match.cand_centre;
        const Eigen::Vector3d ray = T.linear() * match.query_ray;
        num_inexact += std::abs(match.cand_ray.dot(baseline.cross(ray))) > 1e-6 * baseline.norm();
        EXPECT_TRUE(MeetInFront(ray, match.cand_ray, baseline, kParallelRad));
      }
    }
    found += nearest < 1e-4;
  }
  EXPECT_GE(found, 490);
  EXPECT_LE(num_inexact, 30);  // rays of some 1,000 solutions, near double roots
}

TEST(SolveFivePlusOne, SwapGivesTheInverse) {
  const RigProblem problem = MakeRigProblem({});
  std::array<RayMatch, 6> sample = DrawSample(problem.rigs, 4);
  const auto poses = SolveFivePlusOne(sample, kParallelRad);
  for (RayMatch& match : sample) {
    std::swap(match.query_centre, match.cand_centre);
    std::swap(match.query_ray, match.cand_ray);
  }
  const auto swapped = SolveFivePlusOne(sample, kParallelRad);
  ASSERT_EQ(poses.size(), swapped.size());
  ASSERT_FALSE(poses.empty());
  for (const Eigen::Isometry3d& T : poses) {
    double nearest = 1e300;
    for (const Eigen::Isometry3d& other : swapped) {
      nearest = std::min(nearest, PoseError(T, other.inverse()).norm());
    }
    EXPECT_LT(nearest, 1e-6);
  }
}

TEST(SolveFivePlusOne, OneCentreHasNoScale) {
  RigProblemOptions options;
  options.baseline_m = 0.0;
  const RigProblem problem = MakeRigProblem(options);
  for (uint64_t seed = 0; seed < 20; ++seed) {
    EXPECT_TRUE(SolveFivePlusOne(DrawSample(problem.rigs, seed), kParallelRad).empty());
  }
}

}  // namespace
}  // namespace covinz
