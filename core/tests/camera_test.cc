// Camera models: known values, round trips over whole images, pixels without a ray, bad input.
#include "covinz/camera.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace covinz {
namespace {

// The colour camera of TUM freiburg1: strong k3. Source: TUM RGB-D benchmark, calibration page.
Camera Freiburg1() {
  return Camera("FULL_OPENCV", {517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026,
                                1.1633, 0.0, 0.0, 0.0});
}

void ExpectRoundTrip(const Camera& camera, int width, int height) {
  for (int v = 0; v < height; v += 3) {
    for (int u = 0; u < width; u += 3) {
      const Eigen::Vector2d pixel_px(u, v);
      const Eigen::Vector3d bearing = camera.BearingVector(pixel_px);
      ASSERT_NEAR(bearing.norm(), 1.0, 1e-12) << u << " " << v;
      ASSERT_LT((camera.Project(2.5 * bearing) - pixel_px).norm(), 1e-7) << u << " " << v;
    }
  }
}

TEST(Camera, PinholeKnownValues) {
  const Camera camera("PINHOLE", {500.0, 400.0, 320.0, 240.0});
  EXPECT_TRUE(camera.Project({0.1, -0.2, 2.0}).isApprox(Eigen::Vector2d(345.0, 200.0), 1e-12));
  EXPECT_TRUE(camera.BearingVector({320.0, 240.0}).isApprox(Eigen::Vector3d::UnitZ(), 1e-12));
}

TEST(Camera, OpencvKnownValue) {
  // By hand: x = (0.5, 0), r^2 = 0.25, radial 1 + 0.1 * 0.25 = 1.025, tangential p2 * 3 * 0.25.
  const Camera camera("OPENCV", {100.0, 100.0, 0.0, 0.0, 0.1, 0.0, 0.01, 0.02});
  const Eigen::Vector2d expected_px(51.25 + 1.5, 0.25);
  EXPECT_TRUE(camera.Project({0.5, 0.0, 1.0}).isApprox(expected_px, 1e-12));
}

TEST(Camera, FullOpencvDenominator) {
  // By hand: r^2 = 0.25, radial (1 + 0.2 * 0.25) / (1 + 0.4 * 0.25) = 1.05 / 1.1.
  const Camera camera("FULL_OPENCV", {100, 100, 0, 0, 0.2, 0, 0, 0, 0, 0.4, 0, 0});
  EXPECT_NEAR(camera.Project({0.5, 0.0, 1.0}).x(), 50.0 * 1.05 / 1.1, 1e-12);
}

TEST(Camera, FisheyeKnownValues) {
  // By hand: 45 degrees off the axis, a = pi / 4, a_d = a (1 + 0.1 a^2 - 0.02 a^4 + ...).
  const Camera camera("OPENCV_FISHEYE", {100.0, 200.0, 10.0, 20.0, 0.1, -0.02, 0.003, 0.0004});
  const double a2 = M_PI * M_PI / 16.0;
  const double a_d =
      M_PI / 4.0 *
      (1.0 + 0.1 * a2 - 0.02 * a2 * a2 + 0.003 * std::pow(a2, 3) + 0.0004 * std::pow(a2, 4));
  EXPECT_NEAR(camera.Project({3.0, 0.0, 3.0}).x(), 100.0 * a_d + 10.0, 1e-12);
  EXPECT_NEAR(camera.Project({0.0, -3.0, 3.0}).y(), -200.0 * a_d + 20.0, 1e-12);
  EXPECT_TRUE(camera.Project({0.0, 0.0, 2.0}).isApprox(Eigen::Vector2d(10.0, 20.0), 1e-12));
  // Without distortion a right angle is pi / 2 focal lengths from the centre.
  const Camera ideal("OPENCV_FISHEYE", {100.0, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0});
  EXPECT_TRUE(ideal.BearingVector({0.0, 50.0 * M_PI}).isApprox(Eigen::Vector3d::UnitY(), 1e-12));
  EXPECT_NEAR(ideal.BearingVector({200.0, 0.0}).z(), std::cos(2.0), 1e-12);
  EXPECT_TRUE(ideal.Project({0.0, 0.0, 0.0}).hasNaN());
  EXPECT_TRUE(ideal.Project({0.0, 0.0, -1.0}).hasNaN());
  EXPECT_TRUE(ideal.BearingVector({315.0, 0.0}).hasNaN());  // beyond 180 degrees
}

TEST(Camera, RoundTripOverWholeImages) {
  // As wide as a tracking camera's: the corners lie behind the image plane.
  ExpectRoundTrip(
      Camera("OPENCV_FISHEYE", {286.0, 286.0, 420.0, 402.0, -0.0085, 0.0475, -0.0448, 0.0087}), 848,
      800);
  ExpectRoundTrip(Freiburg1(), 640, 480);
  ExpectRoundTrip(Camera("OPENCV", {458.654, 457.296, 367.215, 248.375, -0.28340811, 0.07395907,
                                    0.00019359, 1.76187114e-05}),
                  752, 480);  // EuRoC cam0
  ExpectRoundTrip(Camera("PINHOLE", {525.0, 525.0, 319.5, 239.5}), 640, 480);
}

TEST(Camera, PixelWithoutRayIsNaN) {
  // r (1 - 0.3 r^2) never exceeds 0.703: pixels further out have no ray.
  const Camera camera("OPENCV", {100.0, 100.0, 0.0, 0.0, -0.3, 0.0, 0.0, 0.0});
  EXPECT_TRUE(camera.BearingVector({70.0, 0.0}).allFinite());
  EXPECT_TRUE(camera.BearingVector({71.0, 0.0}).hasNaN());
  EXPECT_TRUE(camera.BearingVector({500.0, 300.0}).hasNaN());
  EXPECT_TRUE(camera.BearingVector({std::nan(""), 0.0}).hasNaN());
}

TEST(Camera, PointBeyondTheFoldOrBehindIsNaN) {
  const Camera camera("OPENCV", {100.0, 100.0, 0.0, 0.0, -0.3, 0.0, 0.0, 0.0});
  EXPECT_TRUE(camera.Project({2.0, 0.0, 1.0}).hasNaN());
  EXPECT_TRUE(camera.Project({0.0, 0.0, -1.0}).hasNaN());
  EXPECT_TRUE(camera.Project({0.0, 0.0, 0.0}).hasNaN());
}

TEST(Camera, RowsAreIndependent) {
  const Camera camera("OPENCV", {100.0, 100.0, 0.0, 0.0, -0.3, 0.0, 0.0, 0.0});
  Points2 pixels_px(3, 2);
  pixels_px << 10.0, 20.0, 900.0, 0.0, -30.0, 5.0;
  const Points3 bearings = BearingVectors(camera, pixels_px);
  EXPECT_TRUE(bearings.row(0).allFinite());
  EXPECT_TRUE(bearings.row(1).array().isNaN().all());
  EXPECT_LT((ProjectPoints(camera, bearings).row(2) - pixels_px.row(2)).norm(), 1e-9);
  EXPECT_EQ(BearingVectors(camera, Points2(0, 2)).rows(), 0);
}

TEST(Camera, RejectsBadDescriptions) {
  const double inf = std::numeric_limits<double>::infinity();
  EXPECT_THROW(Camera("SIMPLE_RADIAL", {1, 1, 1, 1}), InvalidCamera);
  EXPECT_THROW(Camera("PINHOLE", {500, 500, 320}), InvalidCamera);
  EXPECT_THROW(Camera("OPENCV", {500, 500, 320, 240}), InvalidCamera);
  EXPECT_THROW(Camera("PINHOLE", {500, inf, 320, 240}), InvalidCamera);
  EXPECT_THROW(Camera("PINHOLE", {0, 500, 320, 240}), InvalidCamera);
  EXPECT_THROW(Camera("PINHOLE", {500, -500, 320, 240}), InvalidCamera);
}

}  // namespace
}  // namespace covinz
