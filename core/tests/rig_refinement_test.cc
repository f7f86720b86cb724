// The rig refinement: exact data, normal equations against differences, invariances, priors, the
// accuracy that rigid rigs cannot reach, and a covariance that says how wrong the result is.
#include "covinz/rig_refinement.h"

#include <chrono>
#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>

#include "../src/rig_adjustment.h"
#include "refinement_problem.h"

namespace covinz {
namespace {

RefinementProblemOptions Exact(uint64_t seed) {
  RefinementProblemOptions options;
  options.noise_px = 0.0;
  options.odometry_noise_m = 0.0;
  options.odometry_noise_rad = 0.0;
  options.seed = seed;
  return options;
}

RefinementProblemOptions Ordinary(uint64_t seed) {
  RefinementProblemOptions options;
  options.seed = seed;
  return options;
}

// A start as far off as what a minimal solver on noisy rigs gives.
Eigen::Isometry3d Disturb(const Eigen::Isometry3d& T, uint64_t seed) {
  std::mt19937_64 engine(seed);
  Vector6d xi;
  xi << RandomNormal3(engine, 0.005), RandomNormal3(engine, 0.03);
  return T * ExpSE3(xi);
}

CalibratedRefinement Refine(const RefinementProblem& problem, const Eigen::Isometry3d& start) {
  return Refine(problem, problem.Tracks(problem.T_cand_query), start);
}

double Nees(const Vector6d& error, const Matrix6d& covariance) {
  return error.dot(covariance.ldlt().solve(error));
}

double Median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + long(values.size() / 2), values.end());
  return values[values.size() / 2];
}

TEST(RefineRigs, ExactDataGiveTheTruth) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    const RefinementProblem problem = MakeRefinementProblem(Exact(seed));
    RigRefinementOptions options;
    options.max_num_iterations = 30;
    options.min_relative_decrease = 0.0;
    const CalibratedRefinement result = Refine(problem, problem.Tracks(problem.T_cand_query),
                                               Disturb(problem.T_cand_query, seed), options);
    EXPECT_LT(PoseError(problem.T_cand_query, result.T_cand_query).norm(), 1e-5);
    // The pull of the points to infinity is all that is left.
    EXPECT_LT(result.cost, 1.0);
    EXPECT_EQ(size_t(result.num_inlier_tracks),
              problem.Tracks(problem.T_cand_query).begins.size() - 1);
    for (size_t c = 0; c < 3; ++c) {
      EXPECT_LT(PoseError(problem.T_cand_cam[c], result.T_cand_cam[c]).norm(), 1e-5);
    }
    for (size_t c = 0; c < 2; ++c) {
      EXPECT_LT(PoseError(problem.T_query_cam[c], result.T_query_cam[c]).norm(), 1e-5);
    }
  }
}

TEST(RefineRigs, FreeRigPosesAreRecoveredUnderOdometryNoise) {
  // Rigid rigs stop at 0.0285 m and 0.224 degrees of median error, free ones reach 0.0094 m and
  // 0.054 degrees on the same problems.
  std::vector<double> error_m, error_rad, rig_rad, odometry_rad;
  for (uint64_t seed = 0; seed < 40; ++seed) {
    const RefinementProblem problem = MakeRefinementProblem(Ordinary(seed));
    const CalibratedRefinement result = Refine(problem, Disturb(problem.T_cand_query, seed));
    const Vector6d error = PoseError(problem.T_cand_query, result.T_cand_query);
    error_m.push_back(error.tail<3>().norm());
    error_rad.push_back(error.head<3>().norm());
    const auto turn = [&problem](const Eigen::Isometry3d& T) {
      return PoseError(problem.T_cand_cam[1], T).head<3>().norm();
    };
    rig_rad.push_back(turn(result.T_cand_cam[1]));
    odometry_rad.push_back(turn(problem.cand.T_rig_cam[1]));
  }
  EXPECT_LT(Median(error_m), 0.010);
  EXPECT_LT(Median(error_rad), 0.06 * M_PI / 180.0);
  EXPECT_LT(Median(rig_rad), 0.5 * Median(odometry_rad));
}

struct Calibration {
  double mean = 0.0;
  double over = 0.0;  // part above the 99.9 % quantile of chi-squared with 6 degrees of freedom
};

Calibration Calibrate(RefinementProblemOptions options, int num_trials) {
  Calibration result;
  for (int i = 0; i < num_trials; ++i) {
    options.seed = uint64_t(i);
    const RefinementProblem problem = MakeRefinementProblem(options);
    const CalibratedRefinement refined =
        Refine(problem, Disturb(problem.T_cand_query, options.seed));
    const double nees =
        Nees(PoseError(problem.T_cand_query, refined.T_cand_query), refined.covariance);
    result.mean += nees / num_trials;
    result.over += (nees > 22.5 ? 1.0 : 0.0) / num_trials;
  }
  return result;
}

TEST(RefineRigs, CovarianceIsHonestWhateverTheNoise) {
  const auto expect = [](auto change) {
    RefinementProblemOptions options;
    change(options);
    const Calibration c = Calibrate(options, 60);
    EXPECT_GE(c.mean, 2.5);
    EXPECT_LE(c.mean, 9.0);
    EXPECT_LE(c.over, 0.02);
  };
  expect([](RefinementProblemOptions&) {});
  expect([](RefinementProblemOptions& o) { o.noise_px = 0.5; });
  expect([](RefinementProblemOptions& o) { o.num_matches = 150; });
  expect([](RefinementProblemOptions& o) { o.forward = true; });
  expect([](RefinementProblemOptions& o) {
    o.min_step_m = 0.05;
    o.max_step_m = 0.15;
    o.min_depth_m = 5.0;
  });
  // Heavy tails of the odometry.
  expect([](RefinementProblemOptions& o) { o.odometry_tail_share = 0.2; });
}

TEST(RefineRigs, CovarianceIsHonestWhenNeighboursShareTheirErrors) {
  for (const double length_px : {40.0, 80.0, 200.0}) {
    for (const bool wall : {false, true}) {
      RefinementProblemOptions options;
      options.shared_px = 0.7;
      options.shared_length_px = length_px;
      if (wall) {
        options.min_depth_m = 2.9;
        options.max_depth_m = 3.1;
      }
      const Calibration c = Calibrate(options, 40);
      EXPECT_LE(c.mean, 9.0) << length_px << wall;
      EXPECT_LE(c.over, 0.05) << length_px << wall;
    }
  }
}

TEST(RefineRigs, TheAnalyticCovarianceIsThatOfIndependentErrorsAsLargeAsTold) {
  RefinementProblemOptions options = Ordinary(4);
  const auto ratio_of_variances = [](const RefinementProblemOptions& o) {
    const CalibratedRefinement refined = Refine(MakeRefinementProblem(o));
    return (refined.analytic.inverse() * refined.covariance).trace() / 6.0;
  };
  EXPECT_NEAR(ratio_of_variances(options), 1.0, 0.5);
  options.shared_px = 1.0;
  EXPECT_GT(ratio_of_variances(options), 2.0);
}

TEST(RefineRigs, SharedErrorsAreToldFromIndependentOnes) {
  RefinementProblemOptions options = Ordinary(3);
  EXPECT_LT(Refine(MakeRefinementProblem(options)).shared_px, 0.3);
  EXPECT_NEAR(Refine(MakeRefinementProblem(options)).independent_px, 1.0, 0.15);
  options.shared_px = 1.0;
  EXPECT_NEAR(Refine(MakeRefinementProblem(options)).shared_px, 1.0, 0.4);
}

TEST(RefineRigs, OdometryDecidesWhatTheImagesDoNotSay) {
  // One track says nothing on five free poses: the rigs stay as odometry has them.
  const RefinementProblem problem = MakeRefinementProblem(Ordinary(4));
  RigTracks one = problem.Tracks(problem.T_cand_query);
  one.begins.resize(2);
  one.observations.resize(size_t(one.begins[1]));
  const Eigen::Isometry3d start = Disturb(problem.T_cand_query, 4);
  const CalibratedRefinement result = Refine(problem, one, start, {});
  for (size_t c = 0; c < 3; ++c) {
    EXPECT_LT(PoseError(problem.cand.T_rig_cam[c], result.T_cand_cam[c]).norm(), 3e-3);
  }
  for (const Vector6d& residual : result.motion_residuals) EXPECT_LT(residual.norm(), 1.0);
  EXPECT_GT(result.covariance.trace(), 1.0);
}

TEST(RefineRigs, SureOdometryHoldsTheRigsRigid) {
  const RefinementProblem problem = MakeRefinementProblem(Ordinary(5));
  RefinementProblem sure = problem;
  for (RefinedRig* rig : {&sure.cand, &sure.query}) {
    for (RigMotion& motion : rig->motions) motion.covariance = 1e-14 * Matrix6d::Identity();
  }
  const CalibratedRefinement result = Refine(sure, Disturb(problem.T_cand_query, 5));
  for (size_t c = 0; c < 3; ++c) {
    EXPECT_LT(PoseError(problem.cand.T_rig_cam[c], result.T_cand_cam[c]).norm(), 1e-5);
  }
}

TEST(RefineRigs, ScaleThatOnlyOdometryKnowsHasItsUncertainty) {
  // Scale comes from the rigs' baselines alone, so its relative error is theirs at best.
  RefinementProblemOptions options = Ordinary(6);
  options.min_loop_m = options.max_loop_m = 1.0;
  options.min_step_m = options.max_step_m = 0.1;
  const CalibratedRefinement result = Refine(MakeRefinementProblem(options));
  const double sigma_m = std::sqrt(result.covariance.bottomRightCorner<3, 3>().trace());
  EXPECT_GT(sigma_m, 0.02);
}

TEST(RefineRigs, RigsWithoutBaselineNeverClaimAScale) {
  int sure = 0;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    RefinementProblemOptions options = Ordinary(seed);
    options.min_step_m = options.max_step_m = 0.0;
    options.turn_rad = 0.14;
    options.min_loop_m = 0.5;
    const RefinementProblem problem = MakeRefinementProblem(options);
    const CalibratedRefinement result = Refine(problem, Disturb(problem.T_cand_query, seed));
    const double sigma_m = std::sqrt(result.covariance.bottomRightCorner<3, 3>().trace());
    const Vector6d error = PoseError(problem.T_cand_query, result.T_cand_query);
    EXPECT_TRUE(sigma_m > 0.15 || Nees(error, result.covariance) < 30.0) << seed;
    if (sigma_m < 0.05) ++sure;
  }
  EXPECT_EQ(sure, 0);
}

TEST(RefineRigs, GrossErrorsAmongTheTracksHardlyMatter) {
  RefinementProblem problem = MakeRefinementProblem(Ordinary(7));
  const CalibratedRefinement clean = Refine(problem, Disturb(problem.T_cand_query, 7));
  std::mt19937_64 engine(7);
  RigTracks tracks = problem.Tracks(problem.T_cand_query);
  size_t num_spoiled = 0;
  for (size_t i = 0; i < tracks.observations.size(); i += 25) {
    TrackObservation& o = tracks.observations[i];
    o.bearing = (o.bearing + RandomNormal3(engine, 0.05)).normalized();
    ++num_spoiled;
  }
  const CalibratedRefinement result = Refine(problem, tracks, Disturb(problem.T_cand_query, 7), {});
  const Vector6d difference = PoseError(clean.T_cand_query, result.T_cand_query);
  EXPECT_LT(Nees(difference, clean.covariance), 6.0);
  size_t num_outliers = 0;
  for (size_t i = 0; i < tracks.observations.size(); ++i) num_outliers += !result.inliers[i];
  EXPECT_GT(num_outliers, num_spoiled / 2);
}

TEST(RefineRigs, SwappedRigsGiveTheInverse) {
  const RefinementProblem problem = MakeRefinementProblem(Ordinary(8));
  RigTracks tracks = problem.Tracks(problem.T_cand_query);
  std::vector<TrackLink> links =
      InlierLinks(problem.rigs, problem.keypoints, problem.inliers, problem.T_cand_query);
  for (TrackLink& link : links) {
    for (TrackObservation* o : {&link.a, &link.b}) o->camera = (o->camera + 2) % 5;
  }
  RigRefinementOptions options;
  options.max_num_iterations = 30;
  options.min_relative_decrease = 1e-12;
  const CalibratedRefinement forward = Refine(problem, tracks, problem.T_cand_query, options);
  RefinementProblem swapped = problem;
  std::swap(swapped.query, swapped.cand);
  const CalibratedRefinement backward =
      Refine(swapped, MergeTracks(links), problem.T_cand_query.inverse(), options);
  // Equal but for the pull of points to infinity, which is taken from the candidate.
  EXPECT_LT(PoseError(forward.T_cand_query, backward.T_cand_query.inverse()).norm(), 2e-4);
  EXPECT_NEAR(forward.cost, backward.cost, 0.1);
  const Matrix6d Ad = AdjointSE3(backward.T_cand_query);
  const Matrix6d covariance = Ad * backward.covariance * Ad.transpose();
  EXPECT_LT((covariance - forward.covariance).norm(), 0.05 * forward.covariance.norm());
}

TEST(RefineRigs, BodiesMayBeAnywhereInTheRigs) {
  // The same cameras seen from other bodies: the pose follows, and so does its covariance.
  const RefinementProblem problem = MakeRefinementProblem(Ordinary(9));
  std::mt19937_64 engine(9);
  const Eigen::Isometry3d T_body_cand = RandomPose(engine, 2.0, 0.5);
  const Eigen::Isometry3d T_body_query = RandomPose(engine, 1.0, 0.3);
  RefinementProblem moved = problem;
  for (auto& T : moved.cand.T_rig_cam) T = T_body_cand * T;
  for (auto& T : moved.query.T_rig_cam) T = T_body_query * T;
  const Eigen::Isometry3d start = Disturb(problem.T_cand_query, 9);
  const RigTracks tracks = problem.Tracks(problem.T_cand_query);
  const CalibratedRefinement a = Refine(problem, tracks, start, {});
  const CalibratedRefinement b =
      Refine(moved, tracks, T_body_cand * start * T_body_query.inverse(), {});
  EXPECT_LT(PoseError(T_body_cand * a.T_cand_query * T_body_query.inverse(), b.T_cand_query).norm(),
            1e-9);
  EXPECT_NEAR(a.cost, b.cost, 1e-6 * a.cost);
  const Matrix6d Ad = AdjointSE3(T_body_query);
  EXPECT_LT((Ad * a.covariance * Ad.transpose() - b.covariance).norm(), 1e-6 * b.covariance.norm());
}

TEST(RefineRigs, SameInputSameBits) {
  const RefinementProblem problem = MakeRefinementProblem(Ordinary(10));
  const CalibratedRefinement a = Refine(problem, Disturb(problem.T_cand_query, 10));
  const CalibratedRefinement b = Refine(problem, Disturb(problem.T_cand_query, 10));
  EXPECT_EQ(a.T_cand_query.matrix(), b.T_cand_query.matrix());
  EXPECT_EQ(a.covariance, b.covariance);
  EXPECT_EQ(a.cost, b.cost);
}

TEST(RefineRigs, MotionResidualsShowWrongOdometry) {
  std::vector<double> told_right, told_half;
  for (uint64_t seed = 0; seed < 20; ++seed) {
    RefinementProblemOptions options = Ordinary(seed);
    const CalibratedRefinement right = Refine(MakeRefinementProblem(options));
    ASSERT_EQ(right.motion_residuals.size(), 3u);
    for (const Vector6d& e : right.motion_residuals) told_right.push_back(e.squaredNorm());
    options.odometry_told = 0.5;
    for (const Vector6d& e : Refine(MakeRefinementProblem(options)).motion_residuals) {
      told_half.push_back(e.squaredNorm());
    }
  }
  EXPECT_NEAR(Median(told_half) / Median(told_right), 4.0, 1.5);
}

TEST(RefineRigs, ContinuesFromPosesThatARefinementLeft) {
  RefinementProblemOptions problem_options;
  problem_options.seed = 12;
  const RefinementProblem problem = MakeRefinementProblem(problem_options);
  const RigTracks tracks = problem.Tracks(problem.T_cand_query);
  RigRefinementOptions options;
  options.max_num_iterations = 30;
  options.min_relative_decrease = 1e-9;
  const RigRefinement whole =
      RefineRigs(problem.cand, problem.query, tracks, problem.T_cand_query, options);
  options.max_num_iterations = 1;
  const RigRefinement begun =
      RefineRigs(problem.cand, problem.query, tracks, problem.T_cand_query, options);
  options.max_num_iterations = 30;
  const RigPoses start{begun.T_cand_cam, begun.T_query_cam, begun.T_cand_query};
  const RigRefinement continued = RefineRigs(problem.cand, problem.query, tracks, start, options);
  EXPECT_GT(begun.cost, whole.cost);
  EXPECT_NEAR(continued.cost, whole.cost, 1e-5 * whole.cost);
  EXPECT_LT(PoseError(whole.T_cand_query, continued.T_cand_query).norm(), 1e-3);
  // Odometry is what it was: the motion residuals are not of the start.
  for (size_t m = 0; m < whole.motion_residuals.size(); ++m) {
    EXPECT_LT((whole.motion_residuals[m] - continued.motion_residuals[m]).norm(), 0.02);
  }
  RigPoses missing = start;
  missing.T_cand_cam.pop_back();
  EXPECT_THROW(RefineRigs(problem.cand, problem.query, tracks, missing, options),
               std::invalid_argument);
}

TEST(RefineRigs, NoTracksLeaveTheStart) {
  const RefinementProblem problem = MakeRefinementProblem(Ordinary(11));
  const CalibratedRefinement result = Refine(problem, MergeTracks({}), problem.T_cand_query, {});
  EXPECT_LT(PoseError(problem.T_cand_query, result.T_cand_query).norm(), 1e-12);
  EXPECT_EQ(result.num_inlier_tracks, 0);
  EXPECT_GT(result.covariance.trace(), 1e4);
}

TEST(RefineRigs, MalformedInputThrows) {
  const RefinementProblem good = MakeRefinementProblem(Ordinary(12));
  const auto throws = [&good](auto change) {
    RefinementProblem problem = good;
    change(problem);
    EXPECT_THROW(Refine(problem), std::invalid_argument);
  };
  throws([](RefinementProblem& p) { p.cand.T_rig_cam.clear(); });
  throws([](RefinementProblem& p) { p.cand.focal_px.pop_back(); });
  throws([](RefinementProblem& p) { p.cand.focal_px[1] = 0.0; });
  throws([](RefinementProblem& p) { p.cand.T_rig_cam[1].translation().x() = std::nan(""); });
  throws([](RefinementProblem& p) { p.cand.motions.pop_back(); });  // a camera without tie
  throws([](RefinementProblem& p) { p.cand.motions[0].to = 3; });
  throws([](RefinementProblem& p) { p.cand.motions[0].to = p.cand.motions[0].from; });
  throws([](RefinementProblem& p) { p.query.motions[0].covariance.setZero(); });
  throws([](RefinementProblem& p) { p.query.motions[0].covariance(0, 1) = 1.0; });
  RigTracks tracks = good.Tracks(good.T_cand_query);
  tracks.observations[0].camera = 5;
  EXPECT_THROW(RefineRigs(good.cand, good.query, tracks, good.T_cand_query, {}),
               std::invalid_argument);
}

TEST(RigRefinementOptions, Check) {
  const auto throws = [](auto change) {
    RigRefinementOptions options;
    change(options);
    EXPECT_THROW(options.Check(), std::invalid_argument);
  };
  EXPECT_NO_THROW(RigRefinementOptions{}.Check());
  throws([](RigRefinementOptions& o) { o.sigma_px = 0.0; });
  throws([](RigRefinementOptions& o) { o.keypoint_loss = -1.0; });
  throws([](RigRefinementOptions& o) { o.motion_dof = std::nan(""); });
  throws([](RigRefinementOptions& o) { o.max_error_px = 0.0; });
  throws([](RigRefinementOptions& o) { o.max_inverse_distance_per_m = 0.0; });
  throws([](RigRefinementOptions& o) { o.max_num_iterations = -1; });
  throws([](RigRefinementOptions& o) { o.min_relative_decrease = -1.0; });
}

}  // namespace
}  // namespace covinz
