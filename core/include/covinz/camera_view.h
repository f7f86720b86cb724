// What a calibration says of a camera's view: which points are in it, and rays that stand for it.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace covinz {

class CameraView {
 public:
  // T_body_cam is the camera's pose on its robot; the others as of Camera, which throws
  // InvalidCamera.
  CameraView(const std::string& model,
             const std::vector<double>& params,
             int width,
             int height,
             const Eigen::Isometry3d& T_body_cam);

  // Whether a point is in the view, by its angles from the optical axis.
  bool Sees(const Eigen::Vector3d& point_cam) const;

  // Unit vectors in the camera frame that stand for the view.
  const std::vector<Eigen::Vector3d>& rays() const { return rays_; }
  const Eigen::Isometry3d& T_body_cam() const { return T_body_cam_; }
  double focal_px() const { return focal_px_; }

 private:
  // Between two half planes through an axis of the camera; each by (sine, cosine) of its angle from
  // the optical axis.
  struct Sector {
    // From the angle of a ray to that of another, in the plane of the optical axis and this one.
    Sector(const Eigen::Vector3d& low_ray, const Eigen::Vector3d& high_ray, int axis);
    bool Contains(double across, double ahead) const;

    Eigen::Vector2d low, high;
    bool reflex;  // of more than half a turn
  };

  Eigen::Isometry3d T_body_cam_;
  double focal_px_;
  std::vector<Eigen::Vector3d> rays_;
  std::vector<Sector> sectors_;  // across, down
};

}  // namespace covinz
