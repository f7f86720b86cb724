// The charts and Jacobians of se3.h against finite differences, near 0 and near pi too.
#include "covinz/se3.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

namespace covinz {
namespace {

const Eigen::Vector3d kAxis = Eigen::Vector3d(0.3, -0.8, 0.5).normalized();
const std::vector<double> kAngles = {0.0,  1e-12,  1e-8, 9e-6, 1.1e-5, 9e-5, 1.1e-4,
                                     9e-3, 1.1e-2, 0.3,  1.0,  2.0,    3.0,  M_PI - 1e-4};

Vector6d Tangent(double angle) {
  Vector6d xi;
  xi << angle * kAxis, 1.5, -2.0, 0.7;
  return xi;
}

// Central differences of f at 0, column by column.
template <typename Function>
Eigen::MatrixXd Differentiate(const Function& f, int rows, int cols) {
  const double h = 1e-6;
  Eigen::MatrixXd J(rows, cols);
  for (int c = 0; c < cols; ++c) {
    Eigen::VectorXd d = Eigen::VectorXd::Zero(cols);
    d(c) = h;
    J.col(c) = (f(d) - f(-d)) / (2.0 * h);
  }
  return J;
}

TEST(SE3, ExpMatchesAngleAxis) {
  for (const double angle : kAngles) {
    const Eigen::Matrix3d expected = Eigen::AngleAxisd(angle, kAxis).toRotationMatrix();
    EXPECT_LT((ExpSO3(angle * kAxis).toRotationMatrix() - expected).norm(), 1e-14) << angle;
  }
}

TEST(SE3, LogInvertsExp) {
  for (const double angle : kAngles) {
    const Eigen::Vector3d theta = angle * kAxis;
    EXPECT_LT((LogSO3(ExpSO3(theta)) - theta).norm(), 1e-14 + 1e-13 * angle) << angle;
    const Vector6d xi = Tangent(angle);
    EXPECT_LT((LogSE3(ExpSE3(xi)) - xi).norm(), 1e-10) << angle;
  }
}

TEST(SE3, LogKeepsRelativePrecisionOfTinyRotations) {
  const Eigen::Vector3d theta(1e-9, -2e-9, 3e-9);
  EXPECT_LT((LogSO3(ExpSO3(theta)) - theta).norm(), 1e-15 * theta.norm() * 10.0);
}

TEST(SE3, LogIsShortestAndIgnoresQuaternionSign) {
  const Eigen::Quaterniond q = ExpSO3(2.5 * kAxis);
  const Eigen::Quaterniond negative(-q.w(), -q.x(), -q.y(), -q.z());
  EXPECT_EQ(LogSO3(q), LogSO3(negative));
  // 2 pi - 0.1 about the axis is 0.1 the other way round.
  EXPECT_LT((LogSO3(ExpSO3((2.0 * M_PI - 0.1) * kAxis)) + 0.1 * kAxis).norm(), 1e-13);
}

TEST(SE3, LogOfHalfTurns) {
  for (int axis = 0; axis < 3; ++axis) {
    Eigen::Matrix3d R = -Eigen::Matrix3d::Identity();
    R(axis, axis) = 1.0;
    const Eigen::Vector3d theta = LogSO3(R);
    EXPECT_NEAR(std::abs(theta(axis)), M_PI, 1e-14);
    EXPECT_NEAR(theta.norm(), M_PI, 1e-14);
  }
}

TEST(SE3, RightJacobiansMatchFiniteDifferences) {
  for (const double angle : kAngles) {
    const Vector6d xi = Tangent(angle);
    const Eigen::Isometry3d inverse = ExpSE3(xi).inverse();
    const auto step = [&](const Eigen::VectorXd& d) -> Eigen::VectorXd {
      return LogSE3(inverse * ExpSE3(xi + d));
    };
    EXPECT_LT((Differentiate(step, 6, 6) - RightJacobianSE3(xi)).norm(), 1e-8) << angle;
    const auto log = [&](const Eigen::VectorXd& d) -> Eigen::VectorXd {
      return LogSE3(ExpSE3(xi) * ExpSE3(d));
    };
    EXPECT_LT((Differentiate(log, 6, 6) - RightJacobianInverseSE3(xi)).norm(), 1e-8) << angle;
  }
}

TEST(SE3, RightJacobiansAreInverses) {
  for (const double angle : {0.0, 1e-7, 9.9e-3, 1.01e-2, 1.0, M_PI - 1e-9, M_PI, 4.0}) {
    const Vector6d xi = Tangent(angle);
    const Matrix6d product = RightJacobianSE3(xi) * RightJacobianInverseSE3(xi);
    EXPECT_LT((product - Matrix6d::Identity()).norm(), 1e-10) << angle;
  }
}

TEST(SE3, PerturbationMovesAlongTheBodyAxes) {
  // The body looks along map y (90 degrees about z); 1 m ahead in the body is +1 in map y.
  Eigen::Isometry3d T_map_body = ExpSE3((Vector6d() << 0, 0, M_PI / 2, 3, 4, 5).finished());
  const Vector6d xi = (Vector6d() << 0.2, 0, 0, 1, 0, 0).finished();
  const Eigen::Isometry3d moved = T_map_body * ExpSE3(xi);
  EXPECT_LT((moved.translation() - Eigen::Vector3d(3, 5, 5)).norm(), 1e-14);
  EXPECT_LT((LogSE3(T_map_body.inverse() * moved) - xi).norm(), 1e-14);
}

TEST(SE3, AdjointCarriesPerturbationsToTheOuterFrame) {
  const Eigen::Isometry3d T = ExpSE3(Tangent(1.2));
  const auto carried = [&](const Eigen::VectorXd& d) -> Eigen::VectorXd {
    return LogSE3(T * ExpSE3(d) * T.inverse());
  };
  EXPECT_LT((Differentiate(carried, 6, 6) - AdjointSE3(T)).norm(), 1e-8);
}

}  // namespace
}  // namespace covinz
