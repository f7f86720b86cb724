// Binds the fast loop solver: rigs with odometry, its options and solve_loop_fast.
#include "bindings.h"

#include <utility>
#include <vector>

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include "covinz/solve_loop_fast.h"

namespace covinz {
namespace {

namespace nb = nanobind;
using nb::literals::operator""_a;

void BindStageOptions(nb::module_& m) {
  nb::class_<Verticals>(m, "Verticals",
                        "Unit vectors along the vertical in the two reference bodies.")
      .def(
          "__init__",
          [](Verticals* self, const Eigen::Vector3d& query, const Eigen::Vector3d& cand) {
            new (self) Verticals{query, cand};
          },
          "query"_a, "cand"_a, "Both up or both down.")
      .def_ro("query", &Verticals::query)
      .def_ro("cand", &Verticals::cand);
  nb::class_<RigHypothesisOptions>(m, "RigHypothesisOptions", "Options of the joint estimation.")
      .def(nb::init<>())
      .def_rw("max_error_px", &RigHypothesisOptions::max_error_px)
      .def_rw("confidence", &RigHypothesisOptions::confidence)
      .def_rw("min_num_iterations", &RigHypothesisOptions::min_num_iterations)
      .def_rw("max_num_iterations", &RigHypothesisOptions::max_num_iterations)
      .def_rw("max_num_hypotheses", &RigHypothesisOptions::max_num_hypotheses)
      .def_rw("verticals", &RigHypothesisOptions::verticals,
              nb::for_setter(nb::arg("value").none()),
              "Of the two keyframes, None where one is unknown: a source of proposals only.")
      .def_rw("vertical_sigma_rad", &RigHypothesisOptions::vertical_sigma_rad)
      .def("check", &RigHypothesisOptions::Check);
  nb::class_<RigRefinementOptions>(m, "RigRefinementOptions", "Options of the bundle adjustment.")
      .def(nb::init<>())
      .def_rw("sigma_px", &RigRefinementOptions::sigma_px)
      .def_rw("keypoint_loss", &RigRefinementOptions::keypoint_loss)
      .def_rw("motion_dof", &RigRefinementOptions::motion_dof)
      .def_rw("max_error_px", &RigRefinementOptions::max_error_px)
      .def_rw("max_num_iterations", &RigRefinementOptions::max_num_iterations)
      .def("check", &RigRefinementOptions::Check);
  nb::class_<TrackDepthOptions>(m, "TrackDepthOptions", "Which tracks lie in the scene.")
      .def(nb::init<>())
      .def_rw("scene_quantile", &TrackDepthOptions::scene_quantile)
      .def_rw("max_times_nearer", &TrackDepthOptions::max_times_nearer)
      .def_rw("max_sigmas", &TrackDepthOptions::max_sigmas)
      .def("check", &TrackDepthOptions::Check);
  nb::class_<RigSelectionOptions>(m, "RigSelectionOptions", "Options of the ambiguity test.")
      .def(nb::init<>())
      .def_rw("sigma_px", &RigSelectionOptions::sigma_px)
      .def_rw("max_error_sigmas", &RigSelectionOptions::max_error_sigmas)
      .def_rw("min_distinct_m", &RigSelectionOptions::min_distinct_m)
      .def_rw("min_distinct_rad", &RigSelectionOptions::min_distinct_rad)
      .def_rw("min_significance", &RigSelectionOptions::min_significance)
      .def_rw("min_log_likelihood_ratio", &RigSelectionOptions::min_log_likelihood_ratio)
      .def_rw("max_valley_sigmas", &RigSelectionOptions::max_valley_sigmas)
      .def("check", &RigSelectionOptions::Check);
  nb::class_<RefinementCovarianceOptions>(m, "RefinementCovarianceOptions",
                                          "Options of the covariance.")
      .def(nb::init<>())
      .def_rw("cell_rad", &RefinementCovarianceOptions::cell_rad)
      .def_rw("min_length_rad", &RefinementCovarianceOptions::min_length_rad)
      .def_rw("num_octaves", &RefinementCovarianceOptions::num_octaves)
      .def_rw("min_independent_px", &RefinementCovarianceOptions::min_independent_px)
      .def("check", &RefinementCovarianceOptions::Check);
}

void BindFastLoopOptions(nb::module_& m) {
  nb::class_<FastLoopOptions>(m, "FastLoopOptions",
                              "Options of solve_loop_fast; the meaning, unit and source of each\n"
                              "field is in core/include/covinz.")
      .def(nb::init<>())
      .def_rw("matching", &FastLoopOptions::matching)
      .def_rw("hypotheses", &FastLoopOptions::hypotheses)
      .def_rw("refinement", &FastLoopOptions::refinement)
      .def_rw("depth", &FastLoopOptions::depth)
      .def_rw("selection", &FastLoopOptions::selection)
      .def_rw("covariance", &FastLoopOptions::covariance)
      .def_rw("max_num_refined", &FastLoopOptions::max_num_refined)
      .def_rw("min_inlier_share", &FastLoopOptions::min_inlier_share)
      .def_rw("max_num_trial_iterations", &FastLoopOptions::max_num_trial_iterations)
      .def_rw("min_num_inliers", &FastLoopOptions::min_num_inliers)
      .def_rw("min_baseline_m", &FastLoopOptions::min_baseline_m)
      .def_rw("min_baseline_sigmas", &FastLoopOptions::min_baseline_sigmas)
      .def_rw("min_motion_probability", &FastLoopOptions::min_motion_probability)
      .def_rw("max_sigma_translation_m", &FastLoopOptions::max_sigma_translation_m)
      .def_rw("max_translation_m", &FastLoopOptions::max_translation_m)
      .def_rw("max_rotation_rad", &FastLoopOptions::max_rotation_rad)
      .def_rw("instruction_set", &FastLoopOptions::instruction_set,
              "Of all kernels, by default the best one; results differ by rounding at most.")
      .def_rw("seed", &FastLoopOptions::seed)
      .def("check", &FastLoopOptions::Check, "Raises ValueError for a value out of range.");
}

void BindRigs(nb::module_& m) {
  nb::class_<RigMotion>(m, "RigMotion", "What odometry says about two cameras of one rig.")
      .def(
          "__init__",
          [](RigMotion* self, int from_camera, int to_camera, const Matrix6d& covariance) {
            new (self) RigMotion{from_camera, to_camera, covariance};
          },
          "from_camera"_a, "to_camera"_a, "covariance"_a,
          "Positions in the rig; covariance (6, 6) of the right perturbation of their relative\n"
          "pose in the frame of to_camera, [rotation, translation], [rad, m].");
  nb::class_<CameraExposure>(m, "CameraExposure", "How a camera moved while it took its image.")
      .def(
          "__init__",
          [](CameraExposure* self, const Vector6d& twist_before, const Vector6d& twist_after,
             double stamp_sigma_s, double row_s) {
            new (self) CameraExposure{twist_before, twist_after, stamp_sigma_s, row_s};
          },
          "twist_before"_a, "twist_after"_a, "stamp_sigma_s"_a, "row_s"_a,
          "Twists (6,) of the camera in its own frame, [rotation, translation], [rad/s, m/s], "
          "before\n"
          "and after its stamp; standard deviation of the time from the stamp to the middle of "
          "the\n"
          "image; time from a row to the next.");
  nb::class_<LoopRig>(m, "LoopRig", "Keyframes of one session, the reference first.")
      .def(
          "__init__",
          [](LoopRig* self, std::vector<RigCamera> cameras, std::vector<RigMotion> motions,
             std::vector<CameraExposure> exposures) {
            new (self) LoopRig{std::move(cameras), std::move(motions), std::move(exposures)};
          },
          "cameras"_a, "motions"_a, "exposures"_a = std::vector<CameraExposure>{},
          "The motions must tie every camera to the first; exposures by camera, none where all\n"
          "images are of their stamps' very moments.");
}

}  // namespace

void BindFastLoop(nb::module_& m) {
  BindStageOptions(m);
  BindFastLoopOptions(m);
  BindRigs(m);
  m.def("solve_loop_fast", &SolveLoopFast, "query"_a, "cand"_a, "options"_a,
        nb::call_guard<nb::gil_scoped_release>(),
        "Relative pose of the reference keyframes of two rigs, or the stage that failed, by the\n"
        "fast profile. Same seed and input, same result.\n\n"
        "Raises ValueError for an empty rig, malformed cameras or motions, or bad options.");
}

}  // namespace covinz
