// The keypoint residual and the point it is about: values, Jacobians, far points.
#include "covinz/bearing_residual.h"

#include <random>

#include <gtest/gtest.h>

#include "rig_problem.h"

namespace covinz {
namespace {

BearingMeasurement Measure(const Eigen::Vector3d& bearing, double sigma_rad, int camera = 0) {
  return {camera, bearing, TangentBasis(bearing) / sigma_rad};
}

InverseDistancePoint PointAt(const Eigen::Vector3d& position) {
  return {position.normalized(), 1.0 / position.norm()};
}

TEST(TangentBasis, IsOrthonormalEverywhere) {
  std::mt19937_64 engine(1);
  for (int i = 0; i < 100; ++i) {
    Eigen::Vector3d v = RandomNormal3(engine, 1.0).normalized();
    if (i < 2) v = Eigen::Vector3d(0.0, 0.0, i == 0 ? -1.0 : 1.0);
    const Eigen::Matrix<double, 2, 3> basis = TangentBasis(v);
    EXPECT_LT((basis * basis.transpose() - Eigen::Matrix2d::Identity()).norm(), 1e-12);
    EXPECT_LT((basis * v).norm(), 1e-12);
  }
}

TEST(EvaluateBearing, IsTheAngleInStandardDeviations) {
  const Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  const BearingMeasurement measured = Measure(Eigen::Vector3d::UnitZ(), 0.002);
  const InverseDistancePoint point = PointAt({4.0 * std::sin(0.01), 0.0, 4.0 * std::cos(0.01)});
  const BearingResidual residual =
      EvaluateBearing(measured, point, TangentBasis(point.direction), T);
  EXPECT_NEAR(residual.error.norm(), std::sin(0.01) / 0.002, 1e-9);
  EXPECT_TRUE(residual.in_front);
  const InverseDistancePoint behind = PointAt({0.1, 0.0, -4.0});
  EXPECT_FALSE(EvaluateBearing(measured, behind, TangentBasis(behind.direction), T).in_front);
}

TEST(EvaluateBearing, JacobiansMatchDifferences) {
  std::mt19937_64 engine(2);
  for (int i = 0; i < 20; ++i) {
    const Eigen::Isometry3d T = RandomPose(engine, 1.0, 2.0);
    // Also at infinity, and behind the camera.
    InverseDistancePoint point = PointAt(RandomNormal3(engine, 5.0));
    if (i % 5 == 0) point.inverse_distance = 0.0;
    const BearingMeasurement measured = Measure(
        (RayInCamera(point, T).normalized() + RandomNormal3(engine, 0.1)).normalized(), 0.01);
    const auto error = [&measured](const InverseDistancePoint& x, const Eigen::Isometry3d& pose) {
      return EvaluateBearing(measured, x, TangentBasis(x.direction), pose).error;
    };
    const BearingResidual residual =
        EvaluateBearing(measured, point, TangentBasis(point.direction), T);
    const double h = 1e-6;
    for (int k = 0; k < 6; ++k) {
      const Vector6d d = h * Vector6d::Unit(k);
      const Eigen::Vector2d difference =
          (error(point, T * ExpSE3(d)) - error(point, T * ExpSE3(-d))) / (2.0 * h);
      EXPECT_LT((residual.J_cam.col(k) - difference).norm(), 1e-5 * (1.0 + difference.norm()));
    }
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d d = h * Eigen::Vector3d::Unit(k);
      const Eigen::Vector2d difference =
          (error(Perturb(point, d), T) - error(Perturb(point, -d), T)) / (2.0 * h);
      EXPECT_LT((residual.J_point.col(k) - difference).norm(), 1e-5 * (1.0 + difference.norm()));
    }
  }
}

}  // namespace
}  // namespace covinz
