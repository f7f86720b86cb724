// Camera models: pixels to bearing vectors and back.
#pragma once

#include <array>
#include <stdexcept>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace covinz {

// N x 2 pixel positions, N x 3 points or bearing vectors; one a row, as numpy holds them.
using Points2 = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;
using Points3 = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

// The camera description is unknown, incomplete or not finite.
class InvalidCamera : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

// A point is mapped to a plane, distorted there, scaled and shifted. The plane is the image plane
// at z = 1, with the rational radial and the tangential distortion of Brown and Conrady,
//   x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + tangential(p1, p2);
// of a fisheye it is the equidistant plane, whose r is the angle from the axis, also beyond 90
// degrees, with x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8).
//
// Models (names and parameter order of COLMAP):
//   PINHOLE      fx fy cx cy
//   OPENCV       fx fy cx cy k1 k2 p1 p2
//   FULL_OPENCV  fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
//   OPENCV_FISHEYE  fx fy cx cy k1 k2 k3 k4
// Unlike COLMAP, pixel (0, 0) is the centre of the top-left pixel.
//
// Source: Brown, "Decentering distortion of lenses", 1966; Kannala and Brandt, "A generic camera
// model and calibration method", TPAMI 2006; OpenCV, calib3d.
class Camera {
 public:
  // Throws InvalidCamera for an unknown model, a wrong number of parameters, parameters that are
  // not finite or focal lengths that are not positive.
  Camera(const std::string& model, const std::vector<double>& params);

  // Pixel of a point in the camera frame; NaN when the point is behind the camera (of a fisheye: on
  // the axis behind it) or beyond the angle up to which the distortion is one-to-one.
  Eigen::Vector2d Project(const Eigen::Vector3d& point_cam) const;

  // Unit vector in the camera frame; NaN when no ray of the camera projects to the pixel.
  Eigen::Vector3d BearingVector(const Eigen::Vector2d& pixel_px) const;

 private:
  Eigen::Vector2d ToPlane(const Eigen::Vector3d& point_cam) const;
  Eigen::Vector3d BearingOf(const Eigen::Vector2d& x) const;
  Eigen::Vector2d Distort(const Eigen::Vector2d& x) const;
  Eigen::Matrix2d DistortJacobian(const Eigen::Vector2d& x) const;
  Eigen::Vector2d Undistort(const Eigen::Vector2d& x_distorted) const;
  double RadialFactor(double r2) const;
  double RadialFactorDerivative(double r2) const;  // with respect to r^2
  double LargestOneToOneRadius() const;

  Eigen::Vector2d focal_px_;
  Eigen::Vector2d principal_px_;
  bool fisheye_;
  std::array<double, 4> numerator_{};    // of the radial factor, from r^2 on
  std::array<double, 3> denominator_{};  // from r^2 on
  std::array<double, 2> p_{};            // p1, p2
  double max_radius_;                    // largest undistorted radius on the plane
};

// Row-wise BearingVector (N x 2 to N x 3) and Project (N x 3 to N x 2).
Points3 BearingVectors(const Camera& camera, const Points2& pixels_px);
Points2 ProjectPoints(const Camera& camera, const Points3& points_cam);

}  // namespace covinz
