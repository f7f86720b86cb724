// Two-view geometry of bearing vectors: what both RANSACs measure residuals and depths with.
#pragma once

#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace covinz {

// The matched bearings of one query camera and one candidate camera.
struct BearingPairs {
  int query_cam = 0;  // position in its rig
  int cand_cam = 0;
  // One pixel is 1 / focal radians.
  double query_focal_px = 0.0;
  double cand_focal_px = 0.0;
  // Unit vectors in the cameras' own frames; query[i] matches cand[i].
  std::vector<Eigen::Vector3d> query;
  std::vector<Eigen::Vector3d> cand;

  size_t size() const { return query.size(); }
  void Check() const;  // throws std::invalid_argument
};

// E with bearing_cand^T E bearing_query = 0.
Eigen::Matrix3d EssentialMatrix(const Eigen::Isometry3d& T_cand_query);

// First-order distance [px^2] of match i from satisfying the epipolar constraint exactly, moving
// both bearings on the unit sphere. NaN when both epipolar planes vanish (no baseline).
//
// Source: Sampson 1982; on the sphere, each bearing moves in its tangent plane only.
double SquaredSampsonError_px2(const Eigen::Matrix3d& E_cand_query,
                               const BearingPairs& pairs,
                               size_t i);

// Whether match i can come from a point in front of both cameras. Rays that are parallel to within
// max_error_px meet at infinity: there noise alone decides the sign of the depth, so parallel and
// alike in direction counts as in front.
bool InFrontOfBoth(const Eigen::Isometry3d& T_cand_query,
                   const BearingPairs& pairs,
                   size_t i,
                   double max_error_px);

// Matches within max_error_px of the pose and in front of both cameras, ascending.
std::vector<int> FindInliers(const Eigen::Isometry3d& T_cand_query,
                             const BearingPairs& pairs,
                             double max_error_px);

}  // namespace covinz
