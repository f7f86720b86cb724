// SO(3) and SE(3) as this project perturbs them: charts, Jacobians and the adjoint.
//
// One tangent everywhere: xi = [rotation (rad), translation (m)], a right perturbation, split:
//
//   T * Exp(xi) = (R * Exp(theta), p + R * rho),   xi = [theta, rho].
//
// So both halves of xi live in the inner frame of T (the body frame of T_map_body, the query
// body frame of T_cand_query), rho is plainly a translation in metres along that frame's axes,
// and the blocks of a 6x6 covariance read directly. This is the exponential of SO(3) x R^3, not
// the twist of SE(3) (there rho is premultiplied by the left Jacobian of theta); the two agree
// to first order, so Gaussian covariances carry over, but finite residuals do not.
//
// The difference of T from a reference T_ref is Log(T_ref^-1 * T). The reference is what carries
// the covariance: the measured relative pose of an edge residual, the estimate of a loop in the
// scatter of its samples and in its NEES.
#pragma once

#include <cmath>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace covinz {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

// The cross product matrix: Hat(a) * b = a x b.
inline Eigen::Matrix3d Hat(const Eigen::Vector3d& a) {
  Eigen::Matrix3d hat;
  hat << 0.0, -a.z(), a.y(), a.z(), 0.0, -a.x(), -a.y(), a.x(), 0.0;
  return hat;
}

// Unit quaternion of a rotation vector [rad].
inline Eigen::Quaterniond ExpSO3(const Eigen::Vector3d& theta) {
  const double angle = theta.norm();
  // sin(angle / 2) / angle; the series is exact to double precision below its bound.
  const double scale = angle < 1e-4 ? 0.5 - angle * angle / 48.0 : std::sin(0.5 * angle) / angle;
  const Eigen::Vector3d vec = scale * theta;
  return Eigen::Quaterniond(std::cos(0.5 * angle), vec.x(), vec.y(), vec.z()).normalized();
}

// Rotation vector [rad] of norm <= pi; q and -q give the same one unless the angle is pi.
inline Eigen::Vector3d LogSO3(const Eigen::Quaterniond& q) {
  const double sign = q.w() < 0.0 ? -1.0 : 1.0;
  const double w = sign * q.w();
  const double n = q.vec().norm();
  // angle / sin(angle / 2); atan2 stays accurate up to pi, where w vanishes.
  const double scale =
      n < 1e-5 ? 2.0 / w * (1.0 - n * n / (3.0 * w * w)) : 2.0 * std::atan2(n, w) / n;
  return sign * scale * q.vec();
}

inline Eigen::Vector3d LogSO3(const Eigen::Matrix3d& R) { return LogSO3(Eigen::Quaterniond(R)); }

// Angle of a rotation [rad] in [0, pi], by twice its sine and cosine: good at every angle.
inline double RotationAngle(const Eigen::Matrix3d& R) {
  const Eigen::Vector3d axis(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
  return std::atan2(axis.norm(), R.trace() - 1.0);
}

// J_r: Exp(theta + d) = Exp(theta) * Exp(J_r d) to first order in d.
inline Eigen::Matrix3d RightJacobianSO3(const Eigen::Vector3d& theta) {
  const double a2 = theta.squaredNorm();
  const double a = std::sqrt(a2);
  const double half = std::sin(0.5 * a);
  const double b = a < 1e-2 ? 0.5 - a2 / 24.0 + a2 * a2 / 720.0 : 2.0 * half * half / a2;
  const double c =
      a < 1e-2 ? 1.0 / 6.0 - a2 / 120.0 + a2 * a2 / 5040.0 : (a - std::sin(a)) / (a * a2);
  const Eigen::Matrix3d hat = Hat(theta);
  return Eigen::Matrix3d::Identity() - b * hat + c * hat * hat;
}

// J_r^-1: Log(Exp(theta) * Exp(d)) = theta + J_r^-1 d to first order in d; |theta| < 2 pi.
inline Eigen::Matrix3d RightJacobianInverseSO3(const Eigen::Vector3d& theta) {
  const double a2 = theta.squaredNorm();
  const double a = std::sqrt(a2);
  // (1 - (a / 2) cot(a / 2)) / a^2, regular at pi.
  const double c = a < 1e-2 ? 1.0 / 12.0 + a2 / 720.0 + a2 * a2 / 30240.0
                            : (1.0 - 0.5 * a * std::cos(0.5 * a) / std::sin(0.5 * a)) / a2;
  const Eigen::Matrix3d hat = Hat(theta);
  return Eigen::Matrix3d::Identity() + 0.5 * hat + c * hat * hat;
}

// The split chart at the identity; T * ExpSE3(xi) perturbs T.
inline Eigen::Isometry3d ExpSE3(const Vector6d& xi) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = ExpSO3(xi.head<3>()).toRotationMatrix();
  T.translation() = xi.tail<3>();
  return T;
}

// Inverse of ExpSE3: [rotation vector, translation].
inline Vector6d LogSE3(const Eigen::Isometry3d& T) {
  Vector6d xi;
  xi << LogSO3(Eigen::Matrix3d(T.linear())), T.translation();
  return xi;
}

// ExpSE3(xi + d) = ExpSE3(xi) * ExpSE3(J d) to first order in d.
inline Matrix6d RightJacobianSE3(const Vector6d& xi) {
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = RightJacobianSO3(xi.head<3>());
  J.bottomRightCorner<3, 3>() = ExpSO3(xi.head<3>()).toRotationMatrix().transpose();
  return J;
}

// LogSE3(ExpSE3(xi) * ExpSE3(d)) = xi + J d to first order in d.
inline Matrix6d RightJacobianInverseSE3(const Vector6d& xi) {
  Matrix6d J = Matrix6d::Zero();
  J.topLeftCorner<3, 3>() = RightJacobianInverseSO3(xi.head<3>());
  J.bottomRightCorner<3, 3>() = ExpSO3(xi.head<3>()).toRotationMatrix();
  return J;
}

// T_a_b * ExpSE3(xi) * T_a_b^-1 = ExpSE3(Ad xi) to first order: Ad carries a perturbation from
// frame b to frame a. The covariance of T_b_a is therefore Ad * Cov(T_a_b) * Ad^T.
inline Matrix6d AdjointSE3(const Eigen::Isometry3d& T) {
  Matrix6d Ad = Matrix6d::Zero();
  Ad.topLeftCorner<3, 3>() = T.linear();
  Ad.bottomRightCorner<3, 3>() = T.linear();
  Ad.bottomLeftCorner<3, 3>() = Hat(T.translation()) * T.linear();
  return Ad;
}

}  // namespace covinz
