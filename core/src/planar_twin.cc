// Plane fit, and the other decomposition of the plane's homography.
#include "covinz/planar_twin.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

namespace covinz {
namespace {

// n with n . direction = inverse distance: least squares, then three rounds with Cauchy weights.
std::optional<Eigen::Vector3d> FitPlane(const std::vector<InverseDistancePoint>& points) {
  if (points.size() < 3) return std::nullopt;
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double scale2 = std::numeric_limits<double>::infinity();
  for (int round = 0; round < 4; ++round) {
    Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
    double sum = 0.0;
    double weights = 0.0;
    for (const InverseDistancePoint& point : points) {
      const double error = normal.dot(point.direction) - point.inverse_distance;
      const double weight = 1.0 / (1.0 + error * error / scale2);
      A += weight * point.direction * point.direction.transpose();
      b += weight * point.inverse_distance * point.direction;
      sum += weight * error * error;
      weights += weight;
    }
    normal = A.ldlt().solve(b);
    if (!normal.allFinite()) return std::nullopt;
    // In the first round the error is the inverse distance itself: generous.
    scale2 = std::max(sum / weights, 1e-12);
  }
  return normal;
}

struct Decomposition {
  Eigen::Matrix3d R;       // H = R + t n^T
  Eigen::Vector3d normal;  // of length 1
  Eigen::Vector3d translation;
};

// With v the eigenvectors of H^T H and u in the plane of v1 and v3.
Decomposition Decompose(const Eigen::Matrix3d& H,
                        const Eigen::Vector3d& v2,
                        const Eigen::Vector3d& u) {
  Eigen::Matrix3d U, W;
  U << v2, u, v2.cross(u);
  const Eigen::Vector3d Hv2 = H * v2;
  const Eigen::Vector3d Hu = H * u;
  W << Hv2, Hu, Hv2.cross(Hu);
  Decomposition result;
  result.R = Eigen::Quaterniond(Eigen::Matrix3d(W * U.transpose())).normalized().toRotationMatrix();
  result.normal = U.col(2);
  result.translation = (H - result.R) * result.normal;
  return result;
}

}  // namespace

std::optional<Eigen::Isometry3d> PlanarTwin(const Eigen::Isometry3d& T_a_b,
                                            const std::vector<InverseDistancePoint>& points_a) {
  const std::optional<Eigen::Vector3d> normal = FitPlane(points_a);
  if (!normal) return std::nullopt;
  const Eigen::Matrix3d R_b_a = T_a_b.linear().transpose();
  Eigen::Matrix3d H =
      R_b_a * (Eigen::Matrix3d::Identity() - T_a_b.translation() * normal->transpose());
  // The camera went through the plane.
  if (!(H.determinant() > 0.0)) return std::nullopt;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(H.transpose() * H);
  const double s1 = eigen.eigenvalues()(2);  // squared, descending; the middle one is 1
  const double s3 = eigen.eigenvalues()(0);
  if (!(s1 > 1.0 && s3 < 1.0 && s1 - s3 > 1e-9)) return std::nullopt;
  const Eigen::Vector3d v1 = eigen.eigenvectors().col(2);
  const Eigen::Vector3d v2 = eigen.eigenvectors().col(1);
  const Eigen::Vector3d v3 = eigen.eigenvectors().col(0);
  const Eigen::Vector3d along = std::sqrt((1.0 - s3) / (s1 - s3)) * v1;
  const Eigen::Vector3d across = std::sqrt((s1 - 1.0) / (s1 - s3)) * v3;
  Decomposition twin = Decompose(H, v2, along + across);
  const Decomposition other = Decompose(H, v2, along - across);
  // The one whose normal is not ours.
  if (std::abs(twin.normal.dot(*normal)) > std::abs(other.normal.dot(*normal))) twin = other;

  double ours = 0.0;
  double theirs = 0.0;
  for (const InverseDistancePoint& point : points_a) {
    ours += normal->dot(point.direction);
    theirs += twin.normal.dot(point.direction);
  }
  const double inverse_distance =
      ours / theirs;  // of the twin's plane, with the sign of its normal
  if (!(std::abs(theirs) > 0.0 && std::isfinite(inverse_distance) && inverse_distance != 0.0)) {
    return std::nullopt;
  }
  // X_b = R X_a + t.
  Eigen::Isometry3d T_b_a = Eigen::Isometry3d::Identity();
  T_b_a.linear() = twin.R;
  T_b_a.translation() = twin.translation / inverse_distance;
  return T_b_a.inverse();
}

}  // namespace covinz
