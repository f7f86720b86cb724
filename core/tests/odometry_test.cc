// Covariances of odometry's motions, and the path of a session.
#include "covinz/odometry_path.h"

#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>

namespace covinz {
namespace {

constexpr OdometryNoise kNoise{0.01, 0.02, 0.03, 0.03, 0.002, 0.003};

Eigen::Isometry3d Ahead(double x_m) {
  return Eigen::Isometry3d(Eigen::Translation3d(x_m, 0.0, 0.0));
}

TEST(MotionCovariance, AnErrorOfRotationIsALever) {
  Matrix6d turned = Matrix6d::Zero();
  turned(2, 2) = 1e-4;
  const Matrix6d still = Matrix6d::Zero();
  const Matrix6d found = MotionCovariance({{Ahead(1.0), turned}, {Ahead(3.0), still}}, kNoise);
  // Turned by 0.01 rad about z, then three metres ahead: 0.03 m to the side.
  EXPECT_NEAR(found(2, 2), 1e-4 + kMinSigmaRotation * kMinSigmaRotation, 1e-15);
  EXPECT_NEAR(found(4, 4), 9e-4 + kMinSigmaTranslation * kMinSigmaTranslation, 1e-15);
  EXPECT_NEAR(found(2, 4), 3e-4, 1e-15);
}

TEST(MotionCovariance, TheFloorOfARandomWalkCountsOnce) {
  const MotionStep step{Ahead(1.0), std::nullopt};
  const double one = MotionCovariance({step}, kNoise)(3, 3);
  const double two = MotionCovariance({step, step}, kNoise)(3, 3);
  EXPECT_NEAR(two - one, kNoise.translation_per_sqrt_m * kNoise.translation_per_sqrt_m, 1e-15);
}

TEST(UsableCovariance, RefusesWhatSaysNothing) {
  EXPECT_TRUE(UsableCovariance(Matrix6d::Zero()).has_value());
  EXPECT_TRUE(UsableCovariance(1e-4 * Matrix6d::Identity()).has_value());
  EXPECT_FALSE(UsableCovariance(-1e-4 * Matrix6d::Identity()).has_value());
  EXPECT_FALSE(UsableCovariance(1e3 * Matrix6d::Identity()).has_value());
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(UsableCovariance(Matrix6d::Constant(nan)).has_value());
}

TEST(OdometryPath, HasNoTwistsWithoutANeighbour) {
  OdometryPath path(kNoise);
  path.Insert(5, 0, Ahead(0.0), std::nullopt);
  EXPECT_FALSE(path.TwistsOf(5).has_value());
  path.Insert(3, -500'000'000, Ahead(-1.0), std::nullopt);
  const auto twists = path.TwistsOf(5);
  ASSERT_TRUE(twists.has_value());
  EXPECT_NEAR((*twists)(0, 3), 2.0, 1e-12);
  EXPECT_EQ(twists->row(0), twists->row(1));
}

TEST(OdometryPath, KnowsOnlyWhatWasInserted) {
  OdometryPath path(kNoise);
  path.Insert(3, 0, Ahead(0.0), std::nullopt);
  EXPECT_THROW(path.Insert(3, 1, Ahead(1.0), std::nullopt), std::invalid_argument);
  EXPECT_THROW(path.TwistsOf(4), std::invalid_argument);
  EXPECT_THROW(path.Covariance(2, 3), std::invalid_argument);
  EXPECT_EQ(path.NumAfter(2), 1u);
  EXPECT_EQ(path.NumAfter(3), 0u);
}

}  // namespace
}  // namespace covinz
