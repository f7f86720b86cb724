// Binds the choice of a rig's neighbours.
#include "covinz/rig_neighbours.h"

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "bindings.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace covinz {
namespace {

std::vector<Eigen::Isometry3d> ToPoses(const std::vector<Eigen::Matrix4d>& matrices) {
  std::vector<Eigen::Isometry3d> poses;
  poses.reserve(matrices.size());
  for (const Eigen::Matrix4d& matrix : matrices) poses.emplace_back(matrix);
  return poses;
}

}  // namespace

void BindRigNeighbours(nb::module_& m) {
  nb::class_<RigNeighboursOptions>(m, "RigNeighboursOptions",
                                   "Options of choose_rig; the meaning, unit and source of each\n"
                                   "field is in core/include/covinz/rig_neighbours.h.")
      .def(nb::init<>())
      .def_rw("depth_m", &RigNeighboursOptions::depth_m)
      .def_rw("half_view_change", &RigNeighboursOptions::half_view_change)
      .def_rw("min_overlap", &RigNeighboursOptions::min_overlap)
      .def_rw("max_path_m", &RigNeighboursOptions::max_path_m)
      .def_rw("min_steps", &RigNeighboursOptions::min_steps)
      .def_rw("max_error_px", &RigNeighboursOptions::max_error_px)
      .def_rw("odometry", &RigNeighboursOptions::odometry)
      .def("check", &RigNeighboursOptions::Check, "Raises ValueError for a value out of range.");
  nb::class_<CameraView>(m, "CameraView", "What a calibration says of a camera's view.")
      .def(
          "__init__",
          [](CameraView* self, const std::string& model, const std::vector<double>& params,
             int width, int height, const Eigen::Matrix4d& T_body_cam) {
            new (self) CameraView(model, params, width, height, Eigen::Isometry3d(T_body_cam));
          },
          "model"_a, "params"_a, "width"_a, "height"_a, "T_body_cam"_a,
          "Model and parameters as of bearing_vectors, size in pixels, and the camera's pose (4, "
          "4)\n"
          "on its robot.\n\nRaises InvalidCamera for an unknown model or bad parameters.");
  m.def(
      "choose_rig",
      [](const std::vector<Eigen::Matrix4d>& T_odom_body,
         const std::vector<const CameraView*>& views, int reference, int size,
         const RigNeighboursOptions& options) {
        RigChoice choice = ChooseRig(ToPoses(T_odom_body), views, reference, size, options);
        return std::make_pair(std::move(choice.rows), choice.information);
      },
      "T_odom_body"_a, "views"_a, "reference"_a, "size"_a, "options"_a,
      R"(The best rig around a keyframe by odometry and calibration: rows, information.

Args:
    T_odom_body: N odometry poses (4, 4) of keyframes of one session in order of time.
    views: Their N cameras.
    reference: Row of the keyframe that the rig is for.
    size: Keyframes in the rig; all N where there are fewer.
    options: What a rig should be like, and odometry's accuracy.

Returns:
    The reference, then the other rows in order of time; and what they tell about scale, one over
    the relative variance.

Raises:
    ValueError: If the numbers differ, or an option is out of range.)");
}

}  // namespace covinz
