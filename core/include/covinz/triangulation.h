// Where the rays of a track meet, and which tracks meet where the scene cannot be.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "covinz/bearing_residual.h"
#include "covinz/rig_refinement.h"

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

// Options of DropImplausibleTracks.
struct TrackDepthOptions {
  // The scene's inverse distances: this part of all tracks lies below ...
  double scene_quantile = 0.9;
  // ... and tracks up to so many times that inverse distance are kept. [generated loops with 50 %
  // wrong matches: NEES 7 to 8 with 1.2 to 2, 11 with 3, 100 to 500 without the test]
  double max_times_nearer = 1.5;
  // Standard deviations of its inverse distance that a track may lie outside.
  double max_sigmas = 3.0;

  void Check() const;  // throws std::invalid_argument
};

// The tracks that lie in front of the cameras and not far nearer than the scene. A wrong match that
// happens to fit the epipolar geometry lies anywhere along its epipolar line, so mostly much nearer
// than anything real, or behind. Such points have no residual but enormous leverage: a point at 0.1
// m determines the translation to a fraction of a millimetre, wrongly. No robust loss sees that.
//
// Source: leverage points of Rousseeuw and Leroy, "Robust regression and outlier detection", 1987;
// decision 0020. Throws std::invalid_argument on malformed input.
RigTracks DropImplausibleTracks(const RefinedRig& cand,
                                const RefinedRig& query,
                                const RigTracks& tracks,
                                const Eigen::Isometry3d& T_cand_query,
                                const RigRefinementOptions& refinement_options,
                                const TrackDepthOptions& options);

}  // namespace covinz
