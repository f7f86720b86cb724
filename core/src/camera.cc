#include "covinz/camera.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace covinz {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Rays further from the axis than this (84 degrees) do not occur in a perspective image.
constexpr double kMaxRadius = 10.0;
constexpr double kMaxAngle_rad = 3.14159265358979323846;

size_t NumParams(const std::string& model) {
  if (model == "PINHOLE") return 4;
  if (model == "OPENCV") return 8;
  if (model == "FULL_OPENCV") return 12;
  if (model == "OPENCV_FISHEYE") return 8;
  throw InvalidCamera("unknown camera model '" + model +
                      "': expected PINHOLE, OPENCV, FULL_OPENCV or OPENCV_FISHEYE");
}

}  // namespace

Camera::Camera(const std::string& model, const std::vector<double>& params)
    : fisheye_(model == "OPENCV_FISHEYE") {
  const size_t num_params = NumParams(model);
  if (params.size() != num_params) {
    throw InvalidCamera("camera model " + model + " has " + std::to_string(num_params) +
                        " parameters, got " + std::to_string(params.size()));
  }
  if (!std::all_of(params.begin(), params.end(), [](double p) { return std::isfinite(p); })) {
    throw InvalidCamera("camera parameters must be finite");
  }
  if (params[0] <= 0.0 || params[1] <= 0.0) {
    throw InvalidCamera("focal lengths must be positive");
  }
  focal_px_ = {params[0], params[1]};
  principal_px_ = {params[2], params[3]};
  if (fisheye_) {
    std::copy_n(&params[4], 4, numerator_.begin());
  } else if (num_params >= 8) {
    std::copy_n(&params[4], 2, numerator_.begin());
    std::copy_n(&params[6], 2, p_.begin());
  }
  if (num_params == 12) {
    numerator_[2] = params[8];
    std::copy_n(&params[9], 3, denominator_.begin());
  }
  max_radius_ = LargestOneToOneRadius();
}

double Camera::RadialFactor(double r2) const {
  const auto& [n1, n2, n3, n4] = numerator_;
  const auto& [d1, d2, d3] = denominator_;
  return (1.0 + r2 * (n1 + r2 * (n2 + r2 * (n3 + r2 * n4)))) /
         (1.0 + r2 * (d1 + r2 * (d2 + r2 * d3)));
}

double Camera::RadialFactorDerivative(double r2) const {
  const auto& [n1, n2, n3, n4] = numerator_;
  const auto& [d1, d2, d3] = denominator_;
  const double numerator = 1.0 + r2 * (n1 + r2 * (n2 + r2 * (n3 + r2 * n4)));
  const double denominator = 1.0 + r2 * (d1 + r2 * (d2 + r2 * d3));
  const double d_numerator = n1 + r2 * (2.0 * n2 + r2 * (3.0 * n3 + r2 * 4.0 * n4));
  const double d_denominator = d1 + r2 * (2.0 * d2 + r2 * 3.0 * d3);
  return (d_numerator * denominator - numerator * d_denominator) / (denominator * denominator);
}

// A polynomial fitted inside the image may fold back outside it: there two rays share a pixel, and
// the one beyond the fold is not real.
double Camera::LargestOneToOneRadius() const {
  constexpr double kStep = 1e-3;
  const double max_radius = fisheye_ ? kMaxAngle_rad : kMaxRadius;
  for (double r = kStep; r < max_radius; r += kStep) {
    const double r2 = r * r;
    const double slope = RadialFactor(r2) + 2.0 * r2 * RadialFactorDerivative(r2);
    if (!(slope > 0.0 && RadialFactor(r2) > 0.0)) return r - kStep;
  }
  return max_radius;
}

Eigen::Vector2d Camera::ToPlane(const Eigen::Vector3d& point_cam) const {
  if (!fisheye_) {
    return point_cam.z() > 0.0 ? point_cam.hnormalized() : Eigen::Vector2d(kNaN, kNaN);
  }
  const double from_axis = point_cam.head<2>().norm();
  if (from_axis == 0.0 && point_cam.z() > 0.0) return Eigen::Vector2d::Zero();
  return std::atan2(from_axis, point_cam.z()) / from_axis * point_cam.head<2>();
}

Eigen::Vector3d Camera::BearingOf(const Eigen::Vector2d& x) const {
  if (!fisheye_) return x.homogeneous().normalized();
  const double angle = x.norm();
  const double sinc = angle > 0.0 ? std::sin(angle) / angle : 1.0;
  return Eigen::Vector3d(sinc * x.x(), sinc * x.y(), std::cos(angle)).normalized();
}

Eigen::Vector2d Camera::Distort(const Eigen::Vector2d& x) const {
  const double r2 = x.squaredNorm();
  const double xy = x.x() * x.y();
  const Eigen::Vector2d tangential(2.0 * p_[0] * xy + p_[1] * (r2 + 2.0 * x.x() * x.x()),
                                   p_[0] * (r2 + 2.0 * x.y() * x.y()) + 2.0 * p_[1] * xy);
  return RadialFactor(r2) * x + tangential;
}

Eigen::Matrix2d Camera::DistortJacobian(const Eigen::Vector2d& x) const {
  const double r2 = x.squaredNorm();
  const double cross = 2.0 * p_[0] * x.x() + 2.0 * p_[1] * x.y();
  Eigen::Matrix2d tangential;
  tangential << 2.0 * p_[0] * x.y() + 6.0 * p_[1] * x.x(), cross,  //
      cross, 6.0 * p_[0] * x.y() + 2.0 * p_[1] * x.x();
  return RadialFactor(r2) * Eigen::Matrix2d::Identity() +
         2.0 * RadialFactorDerivative(r2) * x * x.transpose() + tangential;
}

// Newton's method with step halving, from the distorted point, inside the one-to-one disc.
Eigen::Vector2d Camera::Undistort(const Eigen::Vector2d& x_distorted) const {
  constexpr int kMaxIterations = 50;
  constexpr double kTolerance = 1e-12;
  Eigen::Vector2d x = x_distorted;
  if (x.norm() > 0.9 * max_radius_) x *= 0.9 * max_radius_ / x.norm();
  Eigen::Vector2d residual = Distort(x) - x_distorted;
  for (int i = 0; i < kMaxIterations; ++i) {
    if (residual.norm() < kTolerance) return x;
    const Eigen::Matrix2d jacobian = DistortJacobian(x);
    if (!(jacobian.determinant() > 0.0)) break;
    Eigen::Vector2d step = jacobian.inverse() * residual;
    Eigen::Vector2d next_residual = Distort(x - step) - x_distorted;
    while ((next_residual.norm() >= residual.norm() || (x - step).norm() > max_radius_) &&
           step.norm() > kTolerance) {
      step *= 0.5;
      next_residual = Distort(x - step) - x_distorted;
    }
    if (step.norm() <= kTolerance) break;  // no way down: the pixel has no ray
    x -= step;
    residual = next_residual;
  }
  // Rounding may stop progress just above the tolerance.
  if (residual.norm() < 1e-9) return x;
  return {kNaN, kNaN};
}

Eigen::Vector2d Camera::Project(const Eigen::Vector3d& point_cam) const {
  const Eigen::Vector2d x = ToPlane(point_cam);
  if (!(x.norm() <= max_radius_)) return {kNaN, kNaN};
  return Distort(x).cwiseProduct(focal_px_) + principal_px_;
}

Eigen::Vector3d Camera::BearingVector(const Eigen::Vector2d& pixel_px) const {
  if (!pixel_px.allFinite()) return Eigen::Vector3d::Constant(kNaN);
  const Eigen::Vector2d x_distorted = (pixel_px - principal_px_).cwiseQuotient(focal_px_);
  return BearingOf(Undistort(x_distorted));
}

Points3 BearingVectors(const Camera& camera, const Points2& pixels_px) {
  Points3 bearings(pixels_px.rows(), 3);
  for (Eigen::Index i = 0; i < pixels_px.rows(); ++i) {
    bearings.row(i) = camera.BearingVector(pixels_px.row(i));
    if (!bearings.row(i).allFinite()) bearings.row(i).setConstant(kNaN);
  }
  return bearings;
}

Points2 ProjectPoints(const Camera& camera, const Points3& points_cam) {
  Points2 pixels_px(points_cam.rows(), 2);
  for (Eigen::Index i = 0; i < points_cam.rows(); ++i) {
    pixels_px.row(i) = camera.Project(points_cam.row(i));
  }
  return pixels_px;
}

}  // namespace covinz
