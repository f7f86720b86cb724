// How far odometry can be trusted: covariances of motions over one keyframe or several.
//
// Covariances are of the right perturbation [rotation (rad), translation (m)] of a motion, in the
// frame of the later body.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/se3.h"

namespace covinz {

// Accuracy of a front-end that nothing is known of: random walks with the metres and radians of a
// path, and their floors [rad, m].
struct OdometryNoise {
  double rotation_per_sqrt_m = 0.01;
  double rotation_per_sqrt_rad = 0.02;
  double translation_per_sqrt_m = 0.03;
  double translation_per_sqrt_rad = 0.03;
  double min_rotation = 0.002;
  double min_translation = 0.003;

  void Check() const;  // throws std::invalid_argument
};

// Nothing is measured better, however sure a front-end is of itself [rad, m]. Keeps covariances
// positive definite that were sent for a robot that stood still.
constexpr double kMinSigmaRotation = 1e-4;
constexpr double kMinSigmaTranslation = 1e-3;
// A variance beyond this says nothing: a turn in full, or ten metres, between neighbours.
constexpr double kMaxStepVariance = 100.0;
// Motions of kilometres (an odometry that blew up) are levers; beyond this only rounding is left.
constexpr double kMaxMotionVariance = 1e4;

// Covariance of a motion whose error grows with its metres and radians.
//
// Source: COVINS-G III-C, "the expected accuracy of the corresponding front-end".
Matrix6d RandomWalk(const Eigen::Isometry3d& T_a_b, const OdometryNoise& noise);

// The covariance of a step as a robot sent it, made symmetric; none when it says nothing.
std::optional<Matrix6d> UsableCovariance(const Matrix6d& sent);

// A step from one keyframe to the next.
struct MotionStep {
  Eigen::Isometry3d T_prev_cur;
  // Of UsableCovariance; none where the front-end's usual accuracy stands in.
  std::optional<Matrix6d> covariance;
};

// Covariance of the motion over consecutive steps. An error before a step is seen from behind it
// through the adjoint of the step backwards: S <- A S A^T + Q with A = Ad(T_cur_prev). The floor of
// the noise is added once to a motion that needs its accuracy. Positive definite, whatever was
// sent.
//
// Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships", 1990
// (compounding), for the right perturbation.
Matrix6d MotionCovariance(const std::vector<MotionStep>& steps, const OdometryNoise& noise);

}  // namespace covinz
