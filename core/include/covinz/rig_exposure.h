// When an image was taken is not known exactly: what that does to rigs whose cameras move.
#pragma once

#include <vector>

#include "covinz/se3.h"

namespace covinz {

struct RefinedRig;
struct RigMotion;

// How a camera moved while it took its image, and how little is known of when that was. The default
// is a camera at rest, or one whose image is of its stamp's very moment.
struct CameraExposure {
  // Of the camera in its own frame, [rotation, translation], [rad/s, m/s], before its stamp and
  // after it.
  Vector6d twist_before = Vector6d::Zero();
  Vector6d twist_after = Vector6d::Zero();
  // Standard deviation of the time between the stamp, whose pose odometry gives, and the middle of
  // the image; also that between the middle and any of its rows.
  double stamp_sigma_s = 0.0;
  // From a row of the image to the next one.
  double row_s = 0.0;

  void Check() const;  // throws std::invalid_argument
};

// The motions of a rig as those between images: an image shows the pose at its stamp moved by
// Exp(twist delta), delta of variance stamp_sigma_s^2, at both ends. As often as not delta is
// negative and the twist the one before, so with Ad = Ad(T_to_from)
//
//   S + E_to + Ad E_from Ad^T,  E = stamp_sigma_s^2 (before before^T + after after^T) / 2.
//
// A camera's delta counts in each motion on its own, which is the safe side. Cameras without
// exposures leave the motions as they are, to the last bit.
//
// Source: decision 0025.
std::vector<RigMotion> MotionsBetweenImages(const RefinedRig& rig);

// What the stamps of both reference images add to the covariance of T_cand_query: right
// perturbation in the query body frame, [rotation, translation], [rad, m]; zero without exposures.
//
// Source: decision 0025.
Matrix6d StampCovariance(const RefinedRig& cand,
                         const RefinedRig& query,
                         const Eigen::Isometry3d& T_cand_query);

// Variance of the angle [rad^2] by which a row of a camera's image is off: what a camera that turns
// does to the parallax between it and another.
double RowVariance_rad2(const CameraExposure& exposure);

}  // namespace covinz
