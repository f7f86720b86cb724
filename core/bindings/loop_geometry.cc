// Binds the loop geometry: cameras, rigs and solve_loop.
#include "bindings.h"

#include <string>
#include <utility>
#include <vector>

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include "covinz/camera.h"
#include "covinz/solve_loop.h"

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
      "FULL_OPENCV, OPENCV_FISHEYE); pixel (0, 0) is the centre of the top-left pixel.\n\n"
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

void BindStageOptions(nb::module_& m) {
  nb::enum_<DescriptorNorm>(m, "DescriptorNorm", "How descriptors are compared.")
      .value("HAMMING", DescriptorNorm::kHamming, "Binary descriptors: ORB.")
      .value("L2", DescriptorNorm::kL2, "Descriptors of numbers: SIFT.");
  nb::class_<MatchingOptions>(m, "MatchingOptions", "Options of the descriptor matching.")
      .def(nb::init<>())
      .def_rw("norm", &MatchingOptions::norm)
      .def_rw("max_ratio", &MatchingOptions::max_ratio)
      .def_rw("mutual", &MatchingOptions::mutual)
      .def_rw("max_distance", &MatchingOptions::max_distance)
      .def("check", &MatchingOptions::Check);
  nb::class_<RelativePoseOptions>(m, "RelativePoseOptions", "Options of the five-point RANSAC.")
      .def(nb::init<>())
      .def_rw("max_error_px", &RelativePoseOptions::max_error_px)
      .def_rw("confidence", &RelativePoseOptions::confidence)
      .def_rw("max_num_iterations", &RelativePoseOptions::max_num_iterations)
      .def("check", &RelativePoseOptions::Check);
  nb::class_<RigRelativePoseOptions>(m, "RigRelativePoseOptions", "Options of the 17-point RANSAC.")
      .def(nb::init<>())
      .def_rw("max_error_px", &RigRelativePoseOptions::max_error_px)
      .def_rw("confidence", &RigRelativePoseOptions::confidence)
      .def_rw("max_num_iterations", &RigRelativePoseOptions::max_num_iterations)
      .def("check", &RigRelativePoseOptions::Check);
  nb::class_<RigScaleOptions>(m, "RigScaleOptions", "Options of the test whether scale shows.")
      .def(nb::init<>())
      .def_rw("max_common_centre_ratio", &RigScaleOptions::max_common_centre_ratio)
      .def_rw("max_error_px", &RigScaleOptions::max_error_px)
      .def_rw("max_num_iterations", &RigScaleOptions::max_num_iterations)
      .def("check", &RigScaleOptions::Check);
  nb::class_<RigCovarianceOptions>(m, "RigCovarianceOptions", "Options of the sampled covariance.")
      .def(nb::init<>())
      .def_rw("num_samples", &RigCovarianceOptions::num_samples)
      .def_rw("max_num_tries", &RigCovarianceOptions::max_num_tries)
      .def_rw("min_inlier_ratio", &RigCovarianceOptions::min_inlier_ratio)
      .def_rw("max_error_px", &RigCovarianceOptions::max_error_px)
      .def_rw("min_sigma_rotation_rad", &RigCovarianceOptions::min_sigma_rotation_rad)
      .def_rw("min_sigma_translation_m", &RigCovarianceOptions::min_sigma_translation_m)
      .def("check", &RigCovarianceOptions::Check);
}

void BindLoopOptions(nb::module_& m) {
  nb::class_<LoopOptions>(m, "LoopOptions",
                          "Options of solve_loop; the meaning, unit and source of each field is\n"
                          "in core/include/covinz.")
      .def(nb::init<>())
      .def_rw("matching", &LoopOptions::matching)
      .def_rw("pair", &LoopOptions::pair)
      .def_rw("rig", &LoopOptions::rig)
      .def_rw("scale", &LoopOptions::scale)
      .def_rw("covariance", &LoopOptions::covariance)
      .def_rw("min_num_matches", &LoopOptions::min_num_matches)
      .def_rw("min_num_pair_inliers", &LoopOptions::min_num_pair_inliers)
      .def_rw("min_num_rig_inliers", &LoopOptions::min_num_rig_inliers)
      .def_rw("min_baseline_m", &LoopOptions::min_baseline_m)
      .def_rw("max_translation_m", &LoopOptions::max_translation_m)
      .def_rw("max_rotation_rad", &LoopOptions::max_rotation_rad)
      .def_rw("max_covariance_trace", &LoopOptions::max_covariance_trace)
      .def_rw("seed", &LoopOptions::seed)
      .def("check", &LoopOptions::Check, "Raises ValueError for a value out of range.");
}

void BindRigCamera(nb::module_& m) {
  nb::class_<RigCamera>(m, "RigCamera", "One keyframe of a rig.")
      .def(
          "__init__",
          [](RigCamera* self, const Eigen::Matrix4d& T_rig_cam, const Points3& bearings,
             const Descriptors& descriptors, double focal_px) {
            RigCamera camera;
            camera.T_rig_cam = Eigen::Isometry3d(T_rig_cam);
            camera.bearings = bearings;
            camera.descriptors = descriptors;
            camera.focal_px = focal_px;
            camera.Check();
            new (self) RigCamera(std::move(camera));
          },
          "T_rig_cam"_a, "bearings"_a, "descriptors"_a, "focal_px"_a,
          "T_rig_cam (4, 4): camera pose in the body frame of the rig's reference keyframe.\n"
          "bearings (N, 3): unit vectors in the camera frame, NaN where a keypoint has none.\n"
          "descriptors (N, D) uint8. focal_px turns thresholds in pixels into angles.\n\n"
          "Raises ValueError for a transform that is not rigid or arrays that do not fit.")
      .def_prop_ro("num_keypoints", [](const RigCamera& self) { return self.bearings.rows(); });
}

std::vector<std::pair<std::string, double>> ToPairs(const std::vector<StageTime>& times) {
  std::vector<std::pair<std::string, double>> pairs;
  for (const StageTime& time : times) pairs.emplace_back(time.name, time.ms);
  return pairs;
}

void BindLoopResult(nb::module_& m) {
  nb::class_<LoopEstimate>(m, "LoopEstimate", "A verified loop.")
      .def_prop_ro(
          "T_cand_query",
          [](const LoopEstimate& self) { return Eigen::Matrix4d(self.T_cand_query.matrix()); },
          "(4, 4): query body in the candidate's body frame, reference keyframes, metric.")
      .def_ro("covariance", &LoopEstimate::covariance,
              "(6, 6) of the right perturbation of T_cand_query in the query body frame,\n"
              "[rotation, translation], [rad, m]; positive definite.")
      .def_ro("num_inliers", &LoopEstimate::num_inliers, "Of the 17-point RANSAC.")
      .def_ro("num_matches", &LoopEstimate::num_matches, "A camera pair, query outermost.")
      .def_ro("num_pair_inliers", &LoopEstimate::num_pair_inliers,
              "Five-point inliers a camera pair, query outermost.")
      .def_ro("num_iterations", &LoopEstimate::num_iterations, "Of the 17-point RANSAC.")
      .def_ro("motion_residuals", &LoopEstimate::motion_residuals,
              "Of the fast profile: per motion of the candidate's rig, then of the query's, (6,),\n"
              "odometry's residuals in its standard deviations.")
      .def_ro("independent_px", &LoopEstimate::independent_px, "Noise of a keypoint's own.")
      .def_ro("shared_px", &LoopEstimate::shared_px, "Noise that neighbouring keypoints share.")
      .def_ro("analytic_covariance", &LoopEstimate::analytic_covariance,
              "Of the fast profile: (6, 6), the inverse Hessian alone, for comparison; else None.")
      .def_prop_ro(
          "stage_ms", [](const LoopEstimate& self) { return ToPairs(self.stage_ms); },
          "Wall time of the stages, in order: (name, ms). matching, pairs (of the paper profile),\n"
          "rig or hypotheses and refinement, covariance. Differs from run to run.");
  nb::class_<LoopSolution>(m, "LoopSolution", "One of several solutions that are alike.")
      .def_prop_ro(
          "T_cand_query",
          [](const LoopSolution& self) { return Eigen::Matrix4d(self.T_cand_query.matrix()); },
          "(4, 4): query body in the candidate's body frame.")
      .def_ro("covariance", &LoopSolution::covariance, "(6, 6), as in LoopEstimate.")
      .def_ro("num_inliers", &LoopSolution::num_inliers)
      .def_ro("cost", &LoopSolution::cost, "-2 log likelihood.");
  nb::class_<LoopRejection>(m, "LoopRejection", "Why there is no loop.")
      .def_ro("stage", &LoopRejection::stage,
              "degenerate, matches, pair_inliers, rig_inliers, scale, covariance, ambiguous,\n"
              "uncertainty, translation or rotation; core/include/covinz/solve_loop.h says what is "
              "counted.")
      .def_ro("pair", &LoopRejection::pair, "Camera pair, query outermost, where one failed.")
      .def_ro("count", &LoopRejection::count)
      .def_ro("threshold", &LoopRejection::threshold)
      .def_ro("solutions", &LoopRejection::solutions, "Of ambiguous: the best two.")
      .def_prop_ro(
          "stage_ms", [](const LoopRejection& self) { return ToPairs(self.stage_ms); },
          "As in LoopEstimate, up to the stage that failed.")
      .def("__repr__", [](const LoopRejection& self) {
        return "LoopRejection(" + self.stage + ": " + std::to_string(self.count) + " against " +
               std::to_string(self.threshold) + ")";
      });
}

}  // namespace

void BindLoopGeometry(nanobind::module_& m) {
  BindCamera(m);
  BindStageOptions(m);
  BindLoopOptions(m);
  BindRigCamera(m);
  BindLoopResult(m);
  m.def("solve_loop", &SolveLoop, "query"_a, "cand"_a, "options"_a,
        nb::call_guard<nb::gil_scoped_release>(),
        "Relative pose of the reference keyframes of two rigs, or the stage that failed.\n"
        "Rigs have one camera or more. Same seed and input, same result.\n\n"
        "Raises ValueError for an empty rig, malformed cameras or bad options.\n"
        "Source: COVINS-G, section III-B2.");
}

}  // namespace covinz
