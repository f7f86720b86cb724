// The whole pipeline on generated keyframes: acceptance, every rejection, invariances, bad input.
#include "covinz/solve_loop.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>

#include "rig_problem.h"

namespace covinz {
namespace {

struct LoopProblem {
  std::vector<RigCamera> query;
  std::vector<RigCamera> cand;
  Eigen::Isometry3d T_cand_query;
};

// A camera that sees the points, with 15 flipped bits in each descriptor, and random clutter.
RigCamera MakeCamera(const Eigen::Isometry3d& T_rig_cam,
                     const std::vector<Eigen::Vector3d>& bearings,
                     const Descriptors& point_descriptors,
                     double focal_px,
                     std::mt19937_64& engine) {
  const Eigen::Index num_points = static_cast<Eigen::Index>(bearings.size());
  const Eigen::Index num_clutter = 100;
  RigCamera camera;
  camera.T_rig_cam = T_rig_cam;
  camera.focal_px = focal_px;
  camera.bearings.resize(num_points + num_clutter, 3);
  camera.descriptors = Descriptors::NullaryExpr(num_points + num_clutter, 32,
                                                [&] { return static_cast<uint8_t>(engine()); });
  for (Eigen::Index i = 0; i < num_points + num_clutter; ++i) {
    if (i < num_points) {
      camera.bearings.row(i) = bearings[static_cast<size_t>(i)];
      camera.descriptors.row(i) = point_descriptors.row(i);
      for (int flip = 0; flip < 15; ++flip) {
        camera.descriptors(i, static_cast<Eigen::Index>(engine() % 32)) ^=
            static_cast<uint8_t>(1u << (engine() % 8));
      }
    } else {
      camera.bearings.row(i) = (Eigen::Vector3d::UnitZ() + RandomNormal3(engine, 0.3)).normalized();
    }
  }
  return camera;
}

LoopProblem MakeLoopProblem(const RigProblemOptions& options) {
  const RigProblem problem = MakeRigProblem(options);
  std::mt19937_64 engine(options.seed + 1000);
  const Descriptors descriptors = Descriptors::NullaryExpr(
      options.num_points, 32, [&] { return static_cast<uint8_t>(engine()); });
  LoopProblem loop;
  loop.T_cand_query = problem.T_cand_query;
  for (int q = 0; q < options.num_query_cams; ++q) {
    const size_t pair = static_cast<size_t>(q * options.num_cand_cams);
    loop.query.push_back(MakeCamera(problem.rigs.T_query_cam[static_cast<size_t>(q)],
                                    problem.rigs.pairs[pair].query, descriptors, options.focal_px,
                                    engine));
  }
  for (int c = 0; c < options.num_cand_cams; ++c) {
    const size_t pair = static_cast<size_t>(c);
    loop.cand.push_back(MakeCamera(problem.rigs.T_cand_cam[pair], problem.rigs.pairs[pair].cand,
                                   descriptors, options.focal_px, engine));
  }
  return loop;
}

RigProblemOptions Ordinary(uint64_t seed) {
  RigProblemOptions options;
  options.noise_px = 0.7;
  options.odometry_noise_m = 0.006;
  options.odometry_noise_rad = 0.002;
  options.seed = seed;
  return options;
}

LoopResult Solve(const LoopProblem& loop, const LoopOptions& options = {}) {
  return SolveLoop(loop.query, loop.cand, options);
}

void ExpectRejected(const LoopResult& result, const std::string& stage) {
  const LoopRejection* rejection = std::get_if<LoopRejection>(&result);
  ASSERT_NE(rejection, nullptr);
  EXPECT_EQ(rejection->stage, stage);
  EXPECT_TRUE(std::isfinite(rejection->count));
}

TEST(SolveLoop, FindsTheLoop) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    const LoopProblem loop = MakeLoopProblem(Ordinary(seed));
    LoopOptions options;
    options.seed = seed;
    const LoopResult result = Solve(loop, options);
    const LoopEstimate* estimate = std::get_if<LoopEstimate>(&result);
    ASSERT_NE(estimate, nullptr) << std::get<LoopRejection>(result).stage;
    const Vector6d error = PoseError(loop.T_cand_query, estimate->T_cand_query);
    EXPECT_LT(error.head<3>().norm(), 0.05);
    EXPECT_LT(error.tail<3>().norm(), 0.25);
    EXPECT_LT(error.dot(estimate->covariance.ldlt().solve(error)), 40.0);
    EXPECT_GE(estimate->num_inliers, 100);
    EXPECT_EQ(estimate->num_matches.size(), 6u);
    for (size_t p = 0; p < 6; ++p) {
      EXPECT_GE(estimate->num_matches[p], estimate->num_pair_inliers[p]);
      EXPECT_GE(estimate->num_pair_inliers[p], 30);
    }
    std::vector<std::string> stages;
    for (const StageTime& stage : estimate->stage_ms) {
      EXPECT_GT(stage.ms, 0.0) << stage.name;
      stages.push_back(stage.name);
    }
    EXPECT_EQ(stages, (std::vector<std::string>{"matching", "pairs", "rig", "covariance"}));
  }
}

TEST(SolveLoop, KeypointsWithoutBearingAreIgnored) {
  LoopProblem loop = MakeLoopProblem(Ordinary(1));
  for (RigCamera& camera : loop.query) {
    camera.bearings.topRows(20).setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  const LoopResult result = Solve(loop);
  ASSERT_TRUE(std::holds_alternative<LoopEstimate>(result));
  for (const int num_matches : std::get<LoopEstimate>(result).num_matches) {
    EXPECT_LE(num_matches, 130 + 5);  // and hardly any clutter
  }
}

TEST(SolveLoop, SameSeedSameBits) {
  const LoopProblem loop = MakeLoopProblem(Ordinary(2));
  LoopOptions options;
  options.seed = 11;
  const LoopEstimate a = std::get<LoopEstimate>(Solve(loop, options));
  const LoopEstimate b = std::get<LoopEstimate>(Solve(loop, options));
  EXPECT_EQ(a.T_cand_query.matrix(), b.T_cand_query.matrix());
  EXPECT_EQ(a.covariance, b.covariance);
  EXPECT_EQ(a.num_inliers, b.num_inliers);
  options.seed = 12;
  const LoopEstimate c = std::get<LoopEstimate>(Solve(loop, options));
  EXPECT_NE(a.T_cand_query.matrix(), c.T_cand_query.matrix());
}

TEST(SolveLoop, SwappedRigsGiveTheInverseWithinTheirCovariance) {
  const LoopProblem loop = MakeLoopProblem(Ordinary(3));
  const LoopEstimate forward = std::get<LoopEstimate>(Solve(loop));
  const LoopEstimate backward = std::get<LoopEstimate>(SolveLoop(loop.cand, loop.query, {}));
  const Vector6d difference = PoseError(forward.T_cand_query, backward.T_cand_query.inverse());
  const Matrix6d Ad = AdjointSE3(backward.T_cand_query);
  const Matrix6d covariance = forward.covariance + Ad * backward.covariance * Ad.transpose();
  EXPECT_LT(difference.dot(covariance.ldlt().solve(difference)), 20.0);
}

TEST(SolveLoop, OdometryFramesDoNotMatter) {
  const LoopProblem loop = MakeLoopProblem(Ordinary(4));
  LoopProblem moved = loop;
  std::mt19937_64 engine(9);
  const Eigen::Isometry3d T_odom_query = RandomPose(engine, 2.0, 50.0);
  // Rig poses as a caller makes them, from odometry poses in another frame.
  for (RigCamera& camera : moved.query) {
    camera.T_rig_cam = T_odom_query.inverse() * (T_odom_query * camera.T_rig_cam);
  }
  const LoopEstimate a = std::get<LoopEstimate>(Solve(loop));
  const LoopEstimate b = std::get<LoopEstimate>(Solve(moved));
  EXPECT_LT(PoseError(a.T_cand_query, b.T_cand_query).norm(), 1e-6);
}

TEST(SolveLoop, SingleCamerasHaveNoScale) {
  RigProblemOptions options = Ordinary(5);
  options.num_query_cams = 1;
  options.num_cand_cams = 1;
  const LoopResult result = Solve(MakeLoopProblem(options));
  ExpectRejected(result, "degenerate");
  EXPECT_EQ(std::get<LoopRejection>(result).count, 0.0);
  EXPECT_EQ(std::get<LoopRejection>(result).threshold, LoopOptions{}.min_baseline_m);
}

TEST(SolveLoop, RigsThatOnlyTurnAreDegenerate) {
  RigProblemOptions options = Ordinary(6);
  options.baseline_m = 0.0;
  options.odometry_noise_m = 0.0;
  ExpectRejected(Solve(MakeLoopProblem(options)), "degenerate");
}

TEST(SolveLoop, NeverGarbageWhereScaleDoesNotShow) {
  // Baselines of odometry noise alone, and a scene 1,000 baselines away.
  for (uint64_t seed = 0; seed < 10; ++seed) {
    for (const bool far_away : {false, true}) {
      RigProblemOptions options = Ordinary(seed);
      options.odometry_noise_rad = 0.0005;
      options.odometry_noise_m = far_away ? 0.006 : 0.015;
      options.baseline_m = far_away ? 0.2 : 0.0;
      options.min_depth_m = far_away ? 200.0 : 2.0;
      options.max_depth_m = far_away ? 600.0 : 6.0;
      const LoopProblem loop = MakeLoopProblem(options);
      const LoopResult result = Solve(loop);
      if (const LoopEstimate* estimate = std::get_if<LoopEstimate>(&result)) {
        const Vector6d error = PoseError(loop.T_cand_query, estimate->T_cand_query);
        EXPECT_LT(error.dot(estimate->covariance.ldlt().solve(error)), 60.0);
      }
    }
  }
}

TEST(SolveLoop, DifferentPlacesShareNoMatches) {
  const LoopProblem here = MakeLoopProblem(Ordinary(7));
  const LoopProblem there = MakeLoopProblem(Ordinary(8));
  const LoopResult result = SolveLoop(here.query, there.cand, {});
  ExpectRejected(result, "matches");
  EXPECT_EQ(std::get<LoopRejection>(result).pair, 0);
  EXPECT_LT(std::get<LoopRejection>(result).count, 30.0);
  EXPECT_EQ(std::get<LoopRejection>(result).threshold, 30.0);
}

TEST(SolveLoop, RejectionNamesThePair) {
  LoopProblem loop = MakeLoopProblem(Ordinary(9));
  // The last candidate camera matches but its rays make no sense.
  loop.cand[2].bearings = loop.cand[2].bearings.colwise().reverse().eval();
  const LoopResult result = Solve(loop);
  ExpectRejected(result, "pair_inliers");
  EXPECT_EQ(std::get<LoopRejection>(result).pair, 2);
  EXPECT_EQ(std::get<LoopRejection>(result).threshold, 30.0);
  EXPECT_EQ(std::get<LoopRejection>(result).stage_ms.size(), 2u);
  EXPECT_EQ(std::get<LoopRejection>(result).stage_ms.back().name, "pairs");
}

TEST(SolveLoop, EveryLimitRejectsAtItsStage) {
  const LoopProblem loop = MakeLoopProblem(Ordinary(10));
  const auto rejected_at = [&loop](const std::string& stage, auto change) {
    LoopOptions options;
    change(options);
    ExpectRejected(Solve(loop, options), stage);
  };
  ASSERT_TRUE(std::holds_alternative<LoopEstimate>(Solve(loop)));
  rejected_at("degenerate", [](LoopOptions& o) { o.min_baseline_m = 10.0; });
  rejected_at("matches", [](LoopOptions& o) { o.min_num_matches = 1000; });
  rejected_at("pair_inliers", [](LoopOptions& o) { o.min_num_pair_inliers = 1000; });
  rejected_at("rig_inliers", [](LoopOptions& o) { o.min_num_rig_inliers = 10000; });
  rejected_at("scale", [](LoopOptions& o) { o.scale.max_common_centre_ratio = 0.01; });
  rejected_at("covariance", [](LoopOptions& o) { o.covariance.max_error_px = 0.01; });
  rejected_at("uncertainty", [](LoopOptions& o) { o.max_covariance_trace = 1e-9; });
  rejected_at("translation", [](LoopOptions& o) { o.max_translation_m = 0.01; });
  rejected_at("rotation", [](LoopOptions& o) { o.max_rotation_rad = 0.01; });
}

TEST(SolveLoop, EmptyKeyframesAreRejectedNotFatal) {
  LoopProblem loop = MakeLoopProblem(Ordinary(11));
  loop.cand[1].bearings.resize(0, 3);
  loop.cand[1].descriptors.resize(0, 32);
  const LoopResult result = Solve(loop);
  ExpectRejected(result, "matches");
  EXPECT_EQ(std::get<LoopRejection>(result).pair, 1);
}

TEST(SolveLoop, MalformedInputThrows) {
  const LoopProblem good = MakeLoopProblem(Ordinary(12));
  EXPECT_THROW(SolveLoop({}, good.cand, {}), std::invalid_argument);
  EXPECT_THROW(SolveLoop(good.query, {}, {}), std::invalid_argument);
  const auto throws = [&good](auto change) {
    LoopProblem loop = good;
    change(loop.query[0]);
    EXPECT_THROW(Solve(loop), std::invalid_argument);
  };
  throws([](RigCamera& c) { c.descriptors.conservativeResize(5, 32); });
  throws([](RigCamera& c) { c.descriptors = Descriptors::Zero(c.bearings.rows(), 16); });
  throws([](RigCamera& c) { c.focal_px = 0.0; });
  throws([](RigCamera& c) { c.T_rig_cam.linear() *= 2.0; });
  throws([](RigCamera& c) { c.T_rig_cam.linear().col(0) *= -1.0; });
  throws([](RigCamera& c) { c.T_rig_cam.translation().x() = std::nan(""); });
  throws([](RigCamera& c) { c.bearings.row(0) *= 3.0; });
}

TEST(LoopOptions, Check) {
  const auto throws = [](auto change) {
    LoopOptions options;
    change(options);
    EXPECT_THROW(options.Check(), std::invalid_argument);
  };
  EXPECT_NO_THROW(LoopOptions{}.Check());
  throws([](LoopOptions& o) { o.matching.max_ratio = 0.0; });
  throws([](LoopOptions& o) { o.pair.max_error_px = 0.0; });
  throws([](LoopOptions& o) { o.rig.confidence = 2.0; });
  throws([](LoopOptions& o) { o.scale.max_num_iterations = 0; });
  throws([](LoopOptions& o) { o.covariance.num_samples = 0; });
  throws([](LoopOptions& o) { o.min_num_pair_inliers = -1; });
  throws([](LoopOptions& o) { o.min_baseline_m = 0.0; });
  throws([](LoopOptions& o) { o.max_translation_m = std::nan(""); });
}

}  // namespace
}  // namespace covinz
