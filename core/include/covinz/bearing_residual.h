// The residual of one keypoint in the rig refinement, with its Jacobians.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace covinz {

// A scene point direction / inverse_distance. At inverse distance zero it lies at infinity,
// slightly below zero beyond: noise puts far points there, and nothing is singular on the way.
//
// Source: Civera, Davison, Montiel, "Inverse depth parametrization for monocular SLAM", T-RO 2008;
// Hartley and Zisserman, "Multiple View Geometry", 2004, section 2.2 (points at infinity).
struct InverseDistancePoint {
  Eigen::Vector3d direction;  // of length 1, from the origin of the frame of the cameras
  double inverse_distance;    // [1/m]
};

// Two vectors that with v, of length 1, make an orthonormal basis; one a row. Smooth but for v =
// -z.
//
// Source: Duff et al., "Building an orthonormal basis, revisited", JCGT 2017.
inline Eigen::Matrix<double, 2, 3> TangentBasis(const Eigen::Vector3d& v) {
  const double sign = v.z() < 0.0 ? -1.0 : 1.0;
  const double a = -1.0 / (sign + v.z());
  const double b = v.x() * v.y() * a;
  Eigen::Matrix<double, 2, 3> basis;
  basis << 1.0 + sign * v.x() * v.x() * a, sign * b, -sign * v.x(),  //
      b, sign + v.y() * v.y() * a, -v.y();
  return basis;
}

// The point as perturbed by the refinement: direction in its tangent plane, inverse distance.
inline InverseDistancePoint Perturb(const InverseDistancePoint& point,
                                    const Eigen::Vector3d& delta) {
  const Eigen::Vector3d moved =
      point.direction + TangentBasis(point.direction).transpose() * delta.head<2>();
  return {moved.normalized(), point.inverse_distance + delta.z()};
}

// The keypoint as measured.
struct BearingMeasurement {
  int camera;
  Eigen::Vector3d bearing;
  // TangentBasis(bearing) over the keypoint's standard deviation [rad].
  Eigen::Matrix<double, 2, 3> whitened_basis;
};

struct BearingResidual {
  Eigen::Vector2d error;              // standard deviations
  bool in_front;                      // whether the point lies on the bearing's side of the camera
  Eigen::Matrix<double, 2, 6> J_cam;  // d error / d perturbation of T_world_cam (tangent of se3.h)
  Eigen::Matrix<double, 2, 3> J_point;  // d error / d perturbation of the point
};

// The vector from the camera to the point, times the inverse distance: finite for far points.
inline Eigen::Vector3d RayInCamera(const InverseDistancePoint& point,
                                   const Eigen::Isometry3d& T_world_cam) {
  return T_world_cam.linear().transpose() *
         (point.direction - point.inverse_distance * T_world_cam.translation());
}

// e = B(z) u / |u|,  u = R^T (d - w t): the predicted ray in the tangent plane of the measured one
// z on the unit sphere, so that it holds for a fisheye as well; its length is the sine of the angle
// between them.
//
// Source: COVINS-G, III-B2 (bearing vectors); Kneip and Furgale, "OpenGV", ICRA 2014 (residuals
// between bearing vectors).
inline BearingResidual EvaluateBearing(const BearingMeasurement& measured,
                                       const InverseDistancePoint& point,
                                       const Eigen::Matrix<double, 2, 3>& point_basis,
                                       const Eigen::Isometry3d& T_world_cam) {
  const Eigen::Vector3d ray = RayInCamera(point, T_world_cam);
  const double inverse_length = 1.0 / ray.norm();
  const Eigen::Vector3d unit = inverse_length * ray;
  BearingResidual result;
  result.error = measured.whitened_basis * unit;
  result.in_front = measured.bearing.dot(unit) > 0.0;
  const Eigen::Matrix<double, 2, 3> J_ray =
      inverse_length * (measured.whitened_basis - result.error * unit.transpose());
  // Turning the camera by theta turns the ray by -theta: d ray = ray x theta.
  result.J_cam.block<1, 3>(0, 0) = Eigen::Vector3d(J_ray.row(0)).cross(ray).transpose();
  result.J_cam.block<1, 3>(1, 0) = Eigen::Vector3d(J_ray.row(1)).cross(ray).transpose();
  result.J_cam.rightCols<3>() = -point.inverse_distance * J_ray;
  const Eigen::Matrix<double, 2, 3> J_world = J_ray * T_world_cam.linear().transpose();
  result.J_point.leftCols<2>() = J_world * point_basis.transpose();
  result.J_point.col(2) = -J_world * T_world_cam.translation();
  return result;
}

}  // namespace covinz
