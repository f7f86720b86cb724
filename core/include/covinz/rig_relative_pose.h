// Relative pose of two camera rigs at metric scale: the 17-point algorithm, its RANSAC and the
// covariance sampled with it.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/epipolar.h"
#include "covinz/se3.h"

namespace covinz {

// Two rigs and the matches between their cameras. A rig is the cameras of neighbouring keyframes
// in the body frame of one of them, its reference keyframe.
struct RigPairs {
  std::vector<Eigen::Isometry3d> T_query_cam;  // camera poses in the query rig's body frame
  std::vector<Eigen::Isometry3d> T_cand_cam;
  std::vector<BearingPairs> pairs;

  size_t NumMatches() const;
  void Check() const;  // throws std::invalid_argument
};

// Longest distance between two cameras of one rig [m]. Without it scale is unobservable.
double LongestBaseline_m(const RigPairs& rigs);

// Options of EstimateRigRelativePose.
struct RigRelativePoseOptions {
  // A match is an inlier up to this Sampson error [px].
  double max_error_px = 2.0;
  // Stop when a better pose would have been found with this probability.
  double confidence = 0.99;
  // The public code's limit.
  int max_num_iterations = 4000;

  void Check() const;  // throws std::invalid_argument
};

struct RigRelativePose {
  Eigen::Isometry3d T_cand_query;         // metric
  std::vector<std::vector<int>> inliers;  // for each of rigs.pairs, ascending
  int num_inliers;
  int num_iterations;
};

// RANSAC over the 17-point algorithm. Every sample draws from every camera pair, since one from a
// single pair loses scale. An inlier lies near its epipolar plane and in front of both cameras.
// Same seed and input, same result. Returns nullopt for fewer than 17 matches or when no pose
// explains 17 of them. Throws std::invalid_argument on malformed input.
//
// Source: COVINS-G, III-B2; Li, Hartley, Kim, "A linear approach to motion estimation using
// generalized camera models", CVPR 2008; minimal solver of OpenGV (Kneip, Furgale, ICRA 2014).
std::optional<RigRelativePose> EstimateRigRelativePose(const RigPairs& rigs,
                                                       const RigRelativePoseOptions& options,
                                                       uint64_t seed);

// Options of SampleRigCovariance.
struct RigCovarianceOptions {
  // Poses that make up the covariance. [public code: 30]
  int num_samples = 30;
  // Samples that fit badly are drawn again, at most this often in all. [public code: 300]
  int max_num_tries = 300;
  // A sample counts if it keeps this part of the inliers ... [public code: 0.8]
  double min_inlier_ratio = 0.8;
  // ... within this Sampson error [px]. [public code: 10 px at a focal length of 800]
  double max_error_px = 6.0;
  // Variances added to the scatter, as standard deviations: all samples share the rigs' odometry,
  // whose error their scatter cannot show. A loop is never surer than one odometry edge.
  double min_sigma_rotation_rad = 0.002;
  double min_sigma_translation_m = 0.003;

  void Check() const;  // throws std::invalid_argument
};

struct RigCovariance {
  // Of the right perturbation of T_cand_query in the query body frame, [rotation, translation],
  // [rad, m]; positive definite.
  Matrix6d covariance;
  int num_samples;  // fewer than asked for: the covariance is not to be trusted
};

// Scatter of 17-point solutions from random inliers about the estimated pose. The estimate is
// itself one such solution, so the scatter describes its error without any scaling; taken about the
// estimate rather than the samples' mean, it counts the estimate's own deviation as error.
//
// Source: COVINS-G, III-B2. Measured on generated loops and on real images: mean NEES 2 to 6 of an
// ideal 6 (the paper reports about 30).
RigCovariance SampleRigCovariance(const RigPairs& rigs,
                                  const RigRelativePose& estimate,
                                  const RigCovarianceOptions& options,
                                  uint64_t seed);

}  // namespace covinz
