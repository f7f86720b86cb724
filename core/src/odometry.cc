// Covariances of odometry's motions.
#include "covinz/odometry.h"

#include <stdexcept>

#include <Eigen/Eigenvalues>

namespace covinz {
namespace {

Matrix6d Diagonal(double rotation, double translation) {
  Vector6d variances;
  variances << Eigen::Vector3d::Constant(rotation), Eigen::Vector3d::Constant(translation);
  return variances.asDiagonal();
}

Matrix6d Symmetric(const Matrix6d& matrix) { return 0.5 * (matrix + matrix.transpose()); }

Matrix6d WithBoundedVariances(const Matrix6d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(covariance);
  const Vector6d variances = eigen.eigenvalues().cwiseMax(0.0).cwiseMin(kMaxMotionVariance);
  return Symmetric(eigen.eigenvectors() * variances.asDiagonal() *
                   eigen.eigenvectors().transpose());
}

}  // namespace

void OdometryNoise::Check() const {
  if (!(rotation_per_sqrt_m >= 0.0 && rotation_per_sqrt_rad >= 0.0 &&
        translation_per_sqrt_m >= 0.0 && translation_per_sqrt_rad >= 0.0)) {
    throw std::invalid_argument("Odometry: random walks must not be negative");
  }
  if (!(min_rotation > 0.0 && min_translation > 0.0)) {
    throw std::invalid_argument("Odometry: floors must be positive");
  }
}

Matrix6d RandomWalk(const Eigen::Isometry3d& T_a_b, const OdometryNoise& noise) {
  const double moved_m = T_a_b.translation().norm();
  const double turned_rad = RotationAngle(T_a_b.linear());
  const auto variance = [&](double per_sqrt_m, double per_sqrt_rad) {
    return per_sqrt_m * per_sqrt_m * moved_m + per_sqrt_rad * per_sqrt_rad * turned_rad;
  };
  return Diagonal(variance(noise.rotation_per_sqrt_m, noise.rotation_per_sqrt_rad),
                  variance(noise.translation_per_sqrt_m, noise.translation_per_sqrt_rad));
}

std::optional<Matrix6d> UsableCovariance(const Matrix6d& sent) {
  // Also false for NaN.
  if (!(sent.array().abs() <= kMaxStepVariance).all()) return std::nullopt;
  const double size = sent.cwiseAbs().maxCoeff();
  const Matrix6d symmetric = Symmetric(sent);
  if ((sent - symmetric).cwiseAbs().maxCoeff() > 1e-6 * size) return std::nullopt;
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(symmetric, Eigen::EigenvaluesOnly);
  if (!(eigen.eigenvalues()(0) >= -1e-9 * size)) return std::nullopt;
  return symmetric;
}

Matrix6d MotionCovariance(const std::vector<MotionStep>& steps, const OdometryNoise& noise) {
  Matrix6d total = Matrix6d::Zero();
  bool has_walk = false;
  for (const MotionStep& step : steps) {
    const Matrix6d back = AdjointSE3(step.T_prev_cur.inverse());
    const Matrix6d carried = back * total * back.transpose();
    total = carried + (step.covariance ? *step.covariance : RandomWalk(step.T_prev_cur, noise));
    has_walk |= !step.covariance;
  }
  if (has_walk) {
    total += Diagonal(noise.min_rotation * noise.min_rotation,
                      noise.min_translation * noise.min_translation);
  }
  total = Symmetric(total);
  if (total.cwiseAbs().maxCoeff() > kMaxMotionVariance) total = WithBoundedVariances(total);
  return total + Diagonal(kMinSigmaRotation * kMinSigmaRotation,
                          kMinSigmaTranslation * kMinSigmaTranslation);
}

}  // namespace covinz
