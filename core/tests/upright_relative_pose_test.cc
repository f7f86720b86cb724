// The upright four-point solver on exact rays.
#include "covinz/upright_relative_pose.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "covinz/random.h"
#include "rig_problem.h"

namespace covinz {
namespace {

constexpr double kParallelRad = 1e-6;

// Matches of four different pairs, and any vertical that the true pose carries over.
std::array<RayMatch, 4> DrawSample(const RigPairs& rigs, uint64_t seed) {
  Random random(seed);
  std::array<RayMatch, 4> sample;
  for (size_t i = 0; i < 4; ++i) {
    const size_t pair = (i + seed) % rigs.pairs.size();
    sample[i] = RayMatchOf(
        rigs, pair, static_cast<size_t>(random.Below(static_cast<int>(rigs.pairs[pair].size()))));
  }
  return sample;
}

Verticals VerticalsOf(const Eigen::Isometry3d& T_cand_query, uint64_t seed) {
  std::mt19937_64 engine(seed);
  const Eigen::Vector3d query = RandomNormal3(engine, 1.0).normalized();
  return {query, T_cand_query.linear() * query};
}

TEST(SolveUprightFourPoint, TheTruthIsAmongTheSolutions) {
  int found = 0;
  for (uint64_t seed = 0; seed < 300; ++seed) {
    RigProblemOptions options;
    options.seed = seed;
    const RigProblem problem = MakeRigProblem(options);
    const Verticals verticals = VerticalsOf(problem.T_cand_query, seed);
    double nearest = 1e300;
    for (const Eigen::Isometry3d& T :
         SolveUprightFourPoint(DrawSample(problem.rigs, seed), verticals, kParallelRad)) {
      EXPECT_TRUE(T.linear().isUnitary(1e-9));
      EXPECT_TRUE((T.linear() * verticals.query).isApprox(verticals.cand, 1e-9));
      nearest = std::min(nearest, PoseError(problem.T_cand_query, T).norm());
    }
    found += nearest < 1e-4;
  }
  EXPECT_GE(found, 297);  // the rest are near double roots
}

TEST(SolveUprightFourPoint, SwapGivesTheInverse) {
  const RigProblem problem = MakeRigProblem({});
  const Verticals verticals = VerticalsOf(problem.T_cand_query, 1);
  std::array<RayMatch, 4> sample = DrawSample(problem.rigs, 1);
  const auto poses = SolveUprightFourPoint(sample, verticals, kParallelRad);
  for (RayMatch& match : sample) {
    std::swap(match.query_centre, match.cand_centre);
    std::swap(match.query_ray, match.cand_ray);
  }
  const auto swapped =
      SolveUprightFourPoint(sample, {verticals.cand, verticals.query}, kParallelRad);
  ASSERT_FALSE(poses.empty());
  ASSERT_EQ(poses.size(), swapped.size());
  for (const Eigen::Isometry3d& T : poses) {
    const bool found = std::any_of(swapped.begin(), swapped.end(), [&](const auto& other) {
      return PoseError(T, other.inverse()).norm() < 1e-6;
    });
    EXPECT_TRUE(found);
  }
}

TEST(SolveUprightFourPoint, NothingThatIsNotFinite) {
  RigProblemOptions options;
  options.num_query_cams = options.num_cand_cams = 1;  // one pair: no scale
  const RigProblem problem = MakeRigProblem(options);
  for (uint64_t seed = 0; seed < 20; ++seed) {
    const Verticals verticals = VerticalsOf(problem.T_cand_query, seed);
    for (const auto& T :
         SolveUprightFourPoint(DrawSample(problem.rigs, seed), verticals, kParallelRad)) {
      EXPECT_TRUE(T.matrix().allFinite());
    }
  }
}

}  // namespace
}  // namespace covinz
