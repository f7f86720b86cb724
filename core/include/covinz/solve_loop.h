// From the keyframes around a place-recognition candidate to a loop closure or the reason why not:
// COVINS-G's pipeline of matching, pre-filter, 17-point RANSAC and sampled covariance.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/camera.h"
#include "covinz/matching.h"
#include "covinz/relative_pose.h"
#include "covinz/rig_relative_pose.h"
#include "covinz/rig_scale.h"
#include "covinz/se3.h"

namespace covinz {

// One keyframe of a rig.
struct RigCamera {
  // Camera pose in the body frame of the rig's reference keyframe, by odometry:
  // T_odom_body(reference)^-1 * T_odom_body(this) * T_body_cam.
  Eigen::Isometry3d T_rig_cam = Eigen::Isometry3d::Identity();
  // Unit bearing vectors in the camera frame; a row of NaN takes no part in matching.
  Points3 bearings;
  // One a bearing vector.
  Descriptors descriptors;
  // Turns thresholds in pixels into angles.
  double focal_px = 0.0;

  void Check() const;  // throws std::invalid_argument
};

// Options of SolveLoop.
struct LoopOptions {
  MatchingOptions matching;
  RelativePoseOptions pair;
  RigRelativePoseOptions rig;
  RigScaleOptions scale;
  RigCovarianceOptions covariance;
  // Matches that every camera pair needs: no fewer can hold the inliers asked for next.
  int min_num_matches = 30;
  // Five-point inliers that every camera pair needs. [paper III-B2: 30]
  int min_num_pair_inliers = 30;
  // 17-point inliers in all. [paper III-B2: 100]
  int min_num_rig_inliers = 100;
  // Two cameras of one rig must be further apart than this [m], or there is no scale.
  double min_baseline_m = 0.01;
  // Largest translation [m] and rotation [rad] between the reference keyframes. Off by default:
  // not in the paper. [public code: 2 m; 50 degrees of yaw]
  double max_translation_m = std::numeric_limits<double>::infinity();
  double max_rotation_rad = std::numeric_limits<double>::infinity();
  // Largest trace of the covariance [rad^2 + m^2]. [public code: 10]
  double max_covariance_trace = 10.0;
  // Same seed and input, same result.
  uint64_t seed = 0;

  void Check() const;  // throws std::invalid_argument
};

// CPU time of the thread in one stage of a solve: "matching", "pairs" (the paper's pre-filter),
// "rig" (its 17-point RANSAC and test of scale) or "hypotheses" and "refinement" (the fast
// profile's, the choice included), "covariance".
struct StageTime {
  std::string name;
  double ms;
};

struct LoopEstimate {
  Eigen::Isometry3d T_cand_query;  // bodies of the two reference keyframes
  // Right perturbation of T_cand_query in the query body frame, [rotation, translation],
  // [rad, m]; positive definite.
  Matrix6d covariance;
  int num_inliers;  // of the 17-point RANSAC
  // For each camera pair, the query camera outermost.
  std::vector<int> num_matches;
  std::vector<int> num_pair_inliers;
  int num_iterations;  // of the 17-point RANSAC
  // Of the fast profile: for each motion of the candidate's rig, then of the query's, how the
  // motion found differs from odometry's, in standard deviations of the latter.
  std::vector<Vector6d> motion_residuals = {};
  // Of the fast profile: standard deviation of a keypoint [px], the part of its own and the part
  // that it shares with its neighbours.
  double independent_px = 0.0;
  double shared_px = 0.0;
  // Of the fast profile: `covariance` were all errors independent and as large as told, for
  // comparison.
  std::optional<Matrix6d> analytic_covariance = std::nullopt;
  // In order; the one thing that differs from run to run.
  std::vector<StageTime> stage_ms = {};
};

// One of several solutions that explain the matches alike.
struct LoopSolution {
  Eigen::Isometry3d T_cand_query;
  Matrix6d covariance;  // as in LoopEstimate
  int num_inliers;
  double cost;  // -2 log likelihood
};

// Why there is no loop: count < threshold, or > threshold for the stages that limit from above.
struct LoopRejection {
  // "degenerate"    longest baseline within a rig [m] < min_baseline_m
  // "matches"       matches of a pair < min_num_matches
  // "pair_inliers"  five-point inliers of a pair < min_num_pair_inliers
  // "rig_inliers"   17-point inliers < min_num_rig_inliers
  // "scale"         part of them that needs no baseline > scale.max_common_centre_ratio; of the
  //                 fast profile: longest motion in a rig [sigmas] < min_baseline_sigmas
  // "covariance"    good samples < covariance.num_samples
  // "ambiguous"     significance of the best solution against a distinct one [sigmas]
  //                 < selection.min_significance; the fast profile's
  // "motions"       probability of odometry's residuals < min_motion_probability; the fast
  // profile's "uncertainty"   trace of the covariance > max_covariance_trace; in the fast profile,
  // predicted
  //                 sigma of the translation [m] > max_sigma_translation_m
  // "translation"   metres > max_translation_m
  // "rotation"      radians > max_rotation_rad
  std::string stage;
  // Camera pair, the query camera outermost; of "matches" and "pair_inliers".
  std::optional<int> pair;
  double count;
  double threshold;
  // Of "ambiguous": the best solution, and the one that is nearly as good.
  std::vector<LoopSolution> solutions = {};
  // In order, up to the stage that failed; differs from run to run.
  std::vector<StageTime> stage_ms = {};
};

using LoopResult = std::variant<LoopEstimate, LoopRejection>;

// Relative pose of the reference keyframes of two rigs. Stops at the first stage that fails.
// Throws std::invalid_argument for an empty rig, malformed cameras or bad options.
//
// Source: COVINS-G, III-B2.
LoopResult SolveLoop(const std::vector<RigCamera>& query,
                     const std::vector<RigCamera>& cand,
                     const LoopOptions& options);

}  // namespace covinz
