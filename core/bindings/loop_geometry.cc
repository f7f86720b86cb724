// Binds the loop geometry: cameras, rigs and solve_loop.
#include "bindings.h"

#include <string>
#include <vector>

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "covinz/camera.h"

namespace covinz {
namespace {

namespace nb = nanobind;
using nb::literals::operator""_a;

void BindCamera(nb::module_& m) {
  nb::exception<InvalidCamera>(m, "InvalidCamera", PyExc_ValueError);
  m.def(
      "bearing_vectors",
      [](const std::string& model, const std::vector<double>& params, const Points2& keypoints_px) {
        return BearingVectors(Camera(model, params), keypoints_px);
      },
      "model"_a, "params"_a, "keypoints_px"_a, nb::call_guard<nb::gil_scoped_release>(),
      "Unit bearing vectors (N, 3) in the camera frame of raw pixels (N, 2); rows of NaN where no\n"
      "ray projects to the pixel. Models and parameter order are COLMAP's (PINHOLE, OPENCV,\n"
      "FULL_OPENCV); pixel (0, 0) is the centre of the top-left pixel.\n\n"
      "Raises InvalidCamera for an unknown model or bad parameters.");
  m.def(
      "project_points",
      [](const std::string& model, const std::vector<double>& params, const Points3& points_cam) {
        return ProjectPoints(Camera(model, params), points_cam);
      },
      "model"_a, "params"_a, "points_cam"_a, nb::call_guard<nb::gil_scoped_release>(),
      "Raw pixels (N, 2) of points (N, 3) in the camera frame; rows of NaN for points behind the\n"
      "camera or outside the range of its distortion.\n\n"
      "Raises InvalidCamera for an unknown model or bad parameters.");
}

}  // namespace

void BindLoopGeometry(nanobind::module_& m) { BindCamera(m); }

}  // namespace covinz
