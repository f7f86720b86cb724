// Where the rays of a track meet.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "covinz/bearing_residual.h"

namespace covinz {

// Linear least squares  min sum_i |B(z_i) R_i^T (d - w t_i)|^2  over points whose direction has a
// component of one along the first ray: exact for rays that meet, at infinity too, and not singular
// for parallel rays. `measured` to `end` are the observations of one track, two at least.
//
// Source: Hartley and Sturm, "Triangulation", CVIU 1997 (the inhomogeneous linear method), for
// bearing vectors.
inline InverseDistancePoint TriangulateTrack(const BearingMeasurement* measured,
                                             const BearingMeasurement* end,
                                             const std::vector<Eigen::Isometry3d>& T_world_cam,
                                             double inverse_distance_information) {
  const Eigen::Vector3d first =
      T_world_cam[static_cast<size_t>(measured->camera)].linear() * measured->bearing;
  const Eigen::Matrix<double, 2, 3> basis = TangentBasis(first);
  Eigen::Matrix3d hessian = Eigen::Vector3d(0.0, 0.0, inverse_distance_information).asDiagonal();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  for (; measured != end; ++measured) {
    const Eigen::Isometry3d& T = T_world_cam[static_cast<size_t>(measured->camera)];
    const Eigen::Matrix<double, 2, 3> to_plane = measured->whitened_basis * T.linear().transpose();
    Eigen::Matrix<double, 2, 3> J;
    J << to_plane * basis.transpose(), -to_plane * T.translation();
    hessian += J.transpose() * J;
    gradient += J.transpose() * (to_plane * first);
  }
  const Eigen::Vector3d delta = -hessian.inverse() * gradient;
  const Eigen::Vector3d direction = first + basis.transpose() * delta.head<2>();
  const double length = direction.norm();
  return {direction / length, delta.z() / length};
}

}  // namespace covinz
