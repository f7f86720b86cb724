// Rays and borders of a view from its calibration.
#include "covinz/camera_view.h"

#include <cmath>

#include "covinz/camera.h"

namespace covinz {
namespace {

// Rays across and down an image.
constexpr int kAcross = 8;
constexpr int kDown = 6;

}  // namespace

CameraView::Sector::Sector(const Eigen::Vector3d& low_ray,
                           const Eigen::Vector3d& high_ray,
                           int axis) {
  const double low_rad = std::atan2(low_ray[axis], low_ray.z());
  const double high_rad = std::atan2(high_ray[axis], high_ray.z());
  low = {std::sin(low_rad), std::cos(low_rad)};
  high = {std::sin(high_rad), std::cos(high_rad)};
  reflex = high_rad - low_rad > M_PI;
}

bool CameraView::Sector::Contains(double across, double ahead) const {
  // Sines of the angles from the lower and to the higher half plane.
  const bool beyond_low = across * low.y() - ahead * low.x() >= 0.0;
  const bool before_high = ahead * high.x() - across * high.y() >= 0.0;
  return reflex ? beyond_low || before_high : beyond_low && before_high;
}

CameraView::CameraView(const std::string& model,
                       const std::vector<double>& params,
                       int width,
                       int height,
                       const Eigen::Isometry3d& T_body_cam)
    : T_body_cam_(T_body_cam) {
  const Camera camera(model, params);
  focal_px_ = 0.5 * (params[0] + params[1]);
  for (int down = 0; down < kDown; ++down) {
    for (int across = 0; across < kAcross; ++across) {
      rays_.push_back(camera.BearingVector(
          {(across + 0.5) / kAcross * width - 0.5, (down + 0.5) / kDown * height - 0.5}));
    }
  }
  const double x = 0.5 * width - 0.5;
  const double y = 0.5 * height - 0.5;
  const double right = width - 1.0;
  const double bottom = height - 1.0;
  sectors_ = {Sector(camera.BearingVector({0.0, y}), camera.BearingVector({right, y}), 0),
              Sector(camera.BearingVector({x, 0.0}), camera.BearingVector({x, bottom}), 1)};
}

bool CameraView::Sees(const Eigen::Vector3d& point_cam) const {
  return sectors_[0].Contains(point_cam.x(), point_cam.z()) &&
         sectors_[1].Contains(point_cam.y(), point_cam.z());
}

}  // namespace covinz
