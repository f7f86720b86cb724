// A camera's view against the angles of its borders.
#include "covinz/camera_view.h"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace covinz {
namespace {

// Sees 220 degrees across and down.
CameraView Fisheye() {
  return CameraView("OPENCV_FISHEYE", {100.0, 100.0, 191.5, 191.5, 0.0, 0.0, 0.0, 0.0}, 384, 384,
                    Eigen::Isometry3d::Identity());
}

TEST(CameraView, SeesWhatIsBetweenTheAnglesOfItsBorders) {
  const double half_turn_rad = 110.0 / 180.0 * M_PI;
  const double fisheye_rad = 191.5 / 100.0;
  ASSERT_NEAR(fisheye_rad, half_turn_rad, 0.01);
  const CameraView pinhole("PINHOLE", {400.0, 410.0, 300.0, 250.0}, 640, 480,
                           Eigen::Isometry3d::Identity());
  const CameraView fisheye = Fisheye();
  std::mt19937_64 engine(3);
  std::normal_distribution<double> normal;
  int num_wide = 0;
  for (int i = 0; i < 10000; ++i) {
    const Eigen::Vector3d p(normal(engine), normal(engine), normal(engine));
    const double across = std::atan2(p.x(), p.z());
    const double down = std::atan2(p.y(), p.z());
    const bool in_pinhole = across > std::atan(-300.0 / 400.0) &&
                            across < std::atan(339.0 / 400.0) && down > std::atan(-250.0 / 410.0) &&
                            down < std::atan(229.0 / 410.0);
    EXPECT_EQ(pinhole.Sees(p), in_pinhole) << p.transpose();
    const bool in_fisheye = std::abs(across) < fisheye_rad && std::abs(down) < fisheye_rad;
    EXPECT_EQ(fisheye.Sees(p), in_fisheye) << p.transpose();
    num_wide += in_fisheye && p.z() < 0.0;
  }
  EXPECT_GT(num_wide, 10);  // behind it, and yet in view
}

}  // namespace
}  // namespace covinz
