// The fast pipeline on generated keyframes: accuracy, honesty, every rejection, invariances,
// faults.
#include "covinz/solve_loop_fast.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "refinement_problem.h"

namespace covinz {
namespace {

struct FastProblem {
  LoopRig query;
  LoopRig cand;
  Eigen::Isometry3d T_cand_query;
};

// Cameras whose descriptors match as the problem says, the wrong matches included.
FastProblem MakeFastProblem(const RefinementProblemOptions& options) {
  const RefinementProblem problem = MakeRefinementProblem(options);
  std::vector<std::vector<int>> all;
  for (const BearingPairs& pairs : problem.rigs.pairs) {
    all.emplace_back(pairs.size());
    std::iota(all.back().begin(), all.back().end(), 0);
  }
  const RigTracks tracks =
      MergeTracks(InlierLinks(problem.rigs, problem.keypoints, all, problem.T_cand_query));
  FastProblem fast{
      {{}, problem.query.motions, {}}, {{}, problem.cand.motions, {}}, problem.T_cand_query};
  std::mt19937_64 engine(options.seed + 1000);
  for (size_t c = 0; c < 5; ++c) {
    int num_rows = 0;
    for (const TrackObservation& o : tracks.observations) {
      if (size_t(o.camera) == c) num_rows = std::max(num_rows, o.keypoint + 1);
    }
    RigCamera camera;
    camera.T_rig_cam = c < 3 ? problem.cand.T_rig_cam[c] : problem.query.T_rig_cam[c - 3];
    camera.focal_px = 458.0;
    camera.bearings = Points3::Constant(num_rows, 3, std::numeric_limits<double>::quiet_NaN());
    camera.descriptors =
        Descriptors::NullaryExpr(num_rows, 32, [&] { return static_cast<uint8_t>(engine()); });
    (c < 3 ? fast.cand : fast.query).cameras.push_back(camera);
  }
  for (int t = 0; t < tracks.NumTracks(); ++t) {
    const Descriptors descriptor =
        Descriptors::NullaryExpr(1, 32, [&] { return static_cast<uint8_t>(engine()); });
    for (int i = tracks.begins[size_t(t)]; i < tracks.begins[size_t(t) + 1]; ++i) {
      const TrackObservation& o = tracks.observations[size_t(i)];
      RigCamera& camera = o.camera < 3 ? fast.cand.cameras[size_t(o.camera)]
                                       : fast.query.cameras[size_t(o.camera - 3)];
      camera.bearings.row(o.keypoint) = o.bearing;
      camera.descriptors.row(o.keypoint) = descriptor;
      for (int flip = 0; flip < 12; ++flip) {
        camera.descriptors(o.keypoint, Eigen::Index(engine() % 32)) ^=
            static_cast<uint8_t>(1u << (engine() % 8));
      }
    }
  }
  return fast;
}

RefinementProblemOptions Ordinary(uint64_t seed) {
  RefinementProblemOptions options;
  options.outlier_share = 0.3;
  options.seed = seed;
  return options;
}

LoopResult Solve(const FastProblem& problem, const FastLoopOptions& options = {}) {
  return SolveLoopFast(problem.query, problem.cand, options);
}

double Nees(const Vector6d& error, const Matrix6d& covariance) {
  return error.dot(covariance.ldlt().solve(error));
}

void ExpectRejected(const LoopResult& result, const std::string& stage) {
  const LoopRejection* rejection = std::get_if<LoopRejection>(&result);
  ASSERT_NE(rejection, nullptr) << "accepted instead of " << stage;
  EXPECT_EQ(rejection->stage, stage);
  EXPECT_TRUE(std::isfinite(rejection->count));
}

std::vector<std::string> StagesOf(const LoopResult& result) {
  std::vector<std::string> names;
  std::visit(
      [&names](const auto& value) {
        for (const StageTime& stage : value.stage_ms) {
          EXPECT_GT(stage.ms, 0.0) << stage.name;
          names.push_back(stage.name);
        }
      },
      result);
  return names;
}

TEST(SolveLoopFast, FindsTheLoop) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    const FastProblem problem = MakeFastProblem(Ordinary(seed));
    FastLoopOptions options;
    options.seed = seed;
    const LoopResult result = Solve(problem, options);
    const LoopEstimate* loop = std::get_if<LoopEstimate>(&result);
    ASSERT_NE(loop, nullptr) << seed << std::get<LoopRejection>(result).stage;
    const Vector6d error = PoseError(problem.T_cand_query, loop->T_cand_query);
    EXPECT_LT(error.head<3>().norm(), 0.005) << seed;
    EXPECT_LT(error.tail<3>().norm(), 0.05) << seed;
    EXPECT_LT(Nees(error, loop->covariance), 22.5) << seed;
    EXPECT_EQ(loop->num_matches.size(), 6u);
    EXPECT_EQ(loop->motion_residuals.size(), 3u);
    EXPECT_NEAR(loop->independent_px, 1.0, 0.2);
    ASSERT_TRUE(loop->analytic_covariance.has_value());
    EXPECT_NEAR((loop->analytic_covariance->inverse() * loop->covariance).trace() / 6.0, 1.0, 0.7);
    int num_inliers = 0;
    for (size_t p = 0; p < 6; ++p) {
      EXPECT_GE(loop->num_matches[p], loop->num_pair_inliers[p]);
      num_inliers += loop->num_pair_inliers[p];
    }
    EXPECT_EQ(loop->num_inliers, num_inliers);
    EXPECT_GE(num_inliers, 600);
  }
}

TEST(SolveLoopFast, NoPairNeedsInliersOfItsOwn) {
  FastProblem problem = MakeFastProblem(Ordinary(1));
  problem.cand.cameras[1].bearings.setConstant(std::numeric_limits<double>::quiet_NaN());
  const LoopResult result = Solve(problem);
  const LoopEstimate* loop = std::get_if<LoopEstimate>(&result);
  ASSERT_NE(loop, nullptr) << std::get<LoopRejection>(result).stage;
  EXPECT_EQ(loop->num_matches[1], 0);
  const Vector6d error = PoseError(problem.T_cand_query, loop->T_cand_query);
  EXPECT_LT(Nees(error, loop->covariance), 22.5);
}

TEST(SolveLoopFast, SameSeedSameBits) {
  const FastProblem problem = MakeFastProblem(Ordinary(2));
  FastLoopOptions options;
  options.seed = 11;
  const LoopEstimate a = std::get<LoopEstimate>(Solve(problem, options));
  const LoopEstimate b = std::get<LoopEstimate>(Solve(problem, options));
  EXPECT_EQ(a.T_cand_query.matrix(), b.T_cand_query.matrix());
  EXPECT_EQ(a.covariance, b.covariance);
  EXPECT_EQ(a.num_inliers, b.num_inliers);
}

TEST(SolveLoopFast, SwappedRigsGiveTheInverseWithinTheirCovariance) {
  const FastProblem problem = MakeFastProblem(Ordinary(3));
  const LoopEstimate forward = std::get<LoopEstimate>(Solve(problem));
  const LoopEstimate backward =
      std::get<LoopEstimate>(SolveLoopFast(problem.cand, problem.query, {}));
  const Vector6d difference = PoseError(forward.T_cand_query, backward.T_cand_query.inverse());
  EXPECT_LT(Nees(difference, forward.covariance), 1.0);
}

TEST(SolveLoopFast, BodiesMayBeAnywhereInTheRigs) {
  const FastProblem problem = MakeFastProblem(Ordinary(4));
  FastProblem moved = problem;
  std::mt19937_64 engine(4);
  const Eigen::Isometry3d T_body_query = RandomPose(engine, 1.0, 0.3);
  for (RigCamera& camera : moved.query.cameras) camera.T_rig_cam = T_body_query * camera.T_rig_cam;
  const LoopEstimate a = std::get<LoopEstimate>(Solve(problem));
  const LoopEstimate b = std::get<LoopEstimate>(Solve(moved));
  const Matrix6d Ad = AdjointSE3(T_body_query);
  const Vector6d difference = PoseError(a.T_cand_query * T_body_query.inverse(), b.T_cand_query);
  EXPECT_LT(Nees(difference, Ad * a.covariance * Ad.transpose()), 1.0);
  EXPECT_LT((Ad * a.covariance * Ad.transpose() - b.covariance).norm(), 0.3 * b.covariance.norm());
}

TEST(SolveLoopFast, RigsThatOnlyTurnNeverGiveAConfidentWrongScale) {
  int num_without_scale = 0;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    RefinementProblemOptions options = Ordinary(seed);
    options.min_step_m = options.max_step_m = 0.0;
    options.turn_rad = 0.14;
    const FastProblem problem = MakeFastProblem(options);
    const LoopResult result = Solve(problem);
    if (const LoopEstimate* loop = std::get_if<LoopEstimate>(&result)) {
      const Vector6d error = PoseError(problem.T_cand_query, loop->T_cand_query);
      EXPECT_LT(Nees(error, loop->covariance), 30.0) << seed;
    } else if (std::get<LoopRejection>(result).stage == "scale") {
      ++num_without_scale;
    }
  }
  EXPECT_GE(num_without_scale, 15);
}

TEST(SolveLoopFast, LittleReliefAndErrorsOfRealImagesAreNoAmbiguity) {
  // One valley, in which the images determine the loop well enough.
  int num_loops = 0;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    RefinementProblemOptions options = Ordinary(seed);
    options.min_depth_m = 2.0;
    options.max_depth_m = 3.5;
    options.min_step_m = 0.1;
    options.max_step_m = 0.25;
    options.turn_rad = 0.1;
    options.max_loop_m = 0.7;
    options.num_matches = 250;
    options.outlier_share = 0.4;
    options.shared_px = 0.5;
    options.odometry_tail_share = 0.2;
    const FastProblem problem = MakeFastProblem(options);
    const LoopResult result = Solve(problem);
    const LoopEstimate* loop = std::get_if<LoopEstimate>(&result);
    if (loop == nullptr) continue;
    ++num_loops;
    EXPECT_LT(PoseError(problem.T_cand_query, loop->T_cand_query).tail<3>().norm(), 0.2) << seed;
  }
  EXPECT_GE(num_loops, 18);
}

TEST(SolveLoopFast, AlikeSolutionsAreRejectedWithBoth) {
  // Of a flat wall seen over short baselines, a translation looks like a rotation.
  int num_ambiguous = 0;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    RefinementProblemOptions options = Ordinary(seed);
    options.min_depth_m = 2.9;
    options.max_depth_m = 3.1;
    options.min_step_m = 0.05;
    options.max_step_m = 0.1;
    options.max_loop_m = 0.7;
    options.num_matches = 200;
    options.outlier_share = 0.5;
    options.shared_px = 1.0;
    options.shared_length_px = 120.0;
    options.odometry_noise_m = 0.01;
    options.odometry_noise_rad = 0.008;
    const FastProblem problem = MakeFastProblem(options);
    const LoopResult result = Solve(problem);
    if (const LoopEstimate* loop = std::get_if<LoopEstimate>(&result)) {
      const Vector6d error = PoseError(problem.T_cand_query, loop->T_cand_query);
      EXPECT_LT(error.tail<3>().norm(), 0.3) << seed;
      continue;
    }
    const LoopRejection& rejection = std::get<LoopRejection>(result);
    if (rejection.stage != "ambiguous") continue;
    ++num_ambiguous;
    ASSERT_EQ(rejection.solutions.size(), 2u);
    EXPECT_LT(rejection.count, rejection.threshold);
    EXPECT_TRUE(
        AreDistinct(rejection.solutions[0].T_cand_query, rejection.solutions[1].T_cand_query, {}));
    EXPECT_GE(rejection.solutions[0].num_inliers, 100);
    for (const LoopSolution& solution : rejection.solutions) {
      EXPECT_GT(Eigen::SelfAdjointEigenSolver<Matrix6d>(solution.covariance).eigenvalues()(0), 0.0);
    }
  }
  EXPECT_GE(num_ambiguous, 1);
}

TEST(SolveLoopFast, EveryLimitRejectsAtItsStage) {
  const FastProblem problem = MakeFastProblem(Ordinary(5));
  const auto rejected_at = [&problem](const std::string& stage, auto change) {
    FastLoopOptions options;
    change(options);
    ExpectRejected(Solve(problem, options), stage);
  };
  ASSERT_TRUE(std::holds_alternative<LoopEstimate>(Solve(problem)));
  rejected_at("degenerate", [](FastLoopOptions& o) { o.min_baseline_m = 10.0; });
  rejected_at("matches", [](FastLoopOptions& o) { o.matching.max_distance = 1; });
  rejected_at("rig_inliers", [](FastLoopOptions& o) { o.min_num_inliers = 1200; });
  rejected_at("scale", [](FastLoopOptions& o) { o.min_baseline_sigmas = 1e4; });
  rejected_at("uncertainty", [](FastLoopOptions& o) { o.max_sigma_translation_m = 1e-5; });
  rejected_at("translation", [](FastLoopOptions& o) { o.max_translation_m = 0.01; });
  rejected_at("rotation", [](FastLoopOptions& o) { o.max_rotation_rad = 0.001; });
}

TEST(SolveLoopFast, TimesTheStagesThatItCameTo) {
  const FastProblem problem = MakeFastProblem(Ordinary(5));
  const auto stages = [&problem](auto change) {
    FastLoopOptions options;
    change(options);
    return StagesOf(Solve(problem, options));
  };
  using Names = std::vector<std::string>;
  EXPECT_EQ(stages([](FastLoopOptions&) {}),
            (Names{"matching", "hypotheses", "refinement", "covariance"}));
  EXPECT_EQ(stages([](FastLoopOptions& o) { o.min_num_inliers = 1200; }),
            (Names{"matching", "hypotheses", "refinement"}));
  EXPECT_EQ(stages([](FastLoopOptions& o) { o.matching.max_distance = 1; }), Names{"matching"});
}

TEST(SolveLoopFast, EveryInstructionSetGivesTheSameLoop) {
  for (uint64_t seed = 0; seed < 4; ++seed) {
    RefinementProblemOptions problem_options = Ordinary(seed);
    if (seed == 3) problem_options.outlier_share = 0.5;
    const FastProblem problem = MakeFastProblem(problem_options);
    FastLoopOptions options;
    options.seed = seed;
    options.instruction_set = InstructionSet::kPortable;
    const LoopEstimate portable = std::get<LoopEstimate>(Solve(problem, options));
    for (const InstructionSet set : {InstructionSet::kNeon, InstructionSet::kSse42,
                                     InstructionSet::kAvx2, InstructionSet::kAvx512}) {
      options.instruction_set = set;
      if (!IsSupported(set)) {
        EXPECT_THROW(Solve(problem, options), std::invalid_argument);
        continue;
      }
      const LoopEstimate loop = std::get<LoopEstimate>(Solve(problem, options));
      EXPECT_LT(PoseError(portable.T_cand_query, loop.T_cand_query).norm(), 1e-6);
      EXPECT_LT((portable.covariance - loop.covariance).cwiseAbs().maxCoeff(), 1e-6);
      EXPECT_EQ(portable.num_inliers, loop.num_inliers);
      // Same bits when asked again.
      const LoopEstimate again = std::get<LoopEstimate>(Solve(problem, options));
      EXPECT_EQ(again.T_cand_query.matrix(), loop.T_cand_query.matrix());
      EXPECT_EQ(again.covariance, loop.covariance);
    }
  }
}

TEST(SolveLoopFast, DifferentPlacesShareNoMatches) {
  const FastProblem here = MakeFastProblem(Ordinary(6));
  const FastProblem there = MakeFastProblem(Ordinary(7));
  ExpectRejected(SolveLoopFast(here.query, there.cand, {}), "matches");
}

TEST(SolveLoopFast, MatchesWithoutGeometryAreRejected) {
  FastProblem problem = MakeFastProblem(Ordinary(8));
  for (RigCamera& camera : problem.cand.cameras) {
    camera.bearings = camera.bearings.colwise().reverse().eval();
  }
  ExpectRejected(Solve(problem), "rig_inliers");
}

TEST(SolveLoopFast, SingleCamerasHaveNoScale) {
  FastProblem problem = MakeFastProblem(Ordinary(9));
  for (LoopRig* rig : {&problem.query, &problem.cand}) {
    rig->cameras.resize(1);
    rig->motions.clear();
  }
  ExpectRejected(Solve(problem), "degenerate");
}

TEST(SolveLoopFast, MalformedInputThrows) {
  const FastProblem good = MakeFastProblem(Ordinary(10));
  const auto throws = [&good](auto change) {
    FastProblem problem = good;
    change(problem.query);
    EXPECT_THROW(Solve(problem), std::invalid_argument);
  };
  throws([](LoopRig& r) { r.cameras.clear(); });
  throws([](LoopRig& r) { r.motions.clear(); });
  throws([](LoopRig& r) { r.motions[0].to = 7; });
  throws([](LoopRig& r) { r.motions[0].covariance.setZero(); });
  throws([](LoopRig& r) { r.cameras[0].focal_px = 0.0; });
  throws([](LoopRig& r) { r.cameras[0].T_rig_cam.linear() *= 2.0; });
  throws([](LoopRig& r) { r.cameras[0].bearings.row(0) = Eigen::RowVector3d(3.0, 0.0, 0.0); });
  throws([](LoopRig& r) { r.cameras[0].descriptors.conservativeResize(5, 32); });
}

TEST(FastLoopOptions, Check) {
  const auto throws = [](auto change) {
    FastLoopOptions options;
    change(options);
    EXPECT_THROW(options.Check(), std::invalid_argument);
  };
  EXPECT_NO_THROW(FastLoopOptions{}.Check());
  throws([](FastLoopOptions& o) { o.matching.max_ratio = 0.0; });
  throws([](FastLoopOptions& o) { o.hypotheses.confidence = 2.0; });
  throws([](FastLoopOptions& o) { o.refinement.sigma_px = 0.0; });
  throws([](FastLoopOptions& o) { o.depth.max_times_nearer = 0.0; });
  throws([](FastLoopOptions& o) { o.selection.cell_rad = 0.0; });
  throws([](FastLoopOptions& o) { o.covariance.num_octaves = 0; });
  throws([](FastLoopOptions& o) { o.max_num_refined = 0; });
  throws([](FastLoopOptions& o) { o.max_num_trial_iterations = -1; });
  throws([](FastLoopOptions& o) { o.min_inlier_share = 2.0; });
  throws([](FastLoopOptions& o) { o.min_num_inliers = -1; });
  throws([](FastLoopOptions& o) { o.max_sigma_translation_m = 0.0; });
}

}  // namespace
}  // namespace covinz
