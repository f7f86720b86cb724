// Binds what is known of odometry's accuracy: motions, and the paths of sessions.
#include <optional>
#include <utility>
#include <vector>

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include "bindings.h"
#include "covinz/odometry_path.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace covinz {
namespace {

using RowMajor6d = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;

RowMajor6d CovarianceOver(const std::vector<Eigen::Matrix4d>& T_odom_body,
                          const std::vector<std::optional<Matrix6d>>& sent,
                          const OdometryNoise& noise) {
  if (T_odom_body.empty() || sent.size() + 1 != T_odom_body.size()) {
    throw nb::value_error("motion_covariance: one covariance for each step");
  }
  std::vector<MotionStep> steps;
  for (size_t i = 0; i < sent.size(); ++i) {
    const Eigen::Isometry3d T_odom_prev(T_odom_body[i]);
    steps.push_back({T_odom_prev.inverse() * Eigen::Isometry3d(T_odom_body[i + 1]),
                     sent[i] ? UsableCovariance(*sent[i]) : std::nullopt});
  }
  return MotionCovariance(steps, noise);
}

void BindPath(nb::module_& m) {
  nb::class_<OdometryPath>(
      m, "OdometryPath",
      R"(Odometry of a session by sequence number, whatever the order of arrival.

All raise ValueError for a keyframe that is not there.

Args:
    noise: The front-end's usual accuracy.)")
      .def(nb::init<const OdometryNoise&>(), "noise"_a)
      .def(
          "insert",
          [](OdometryPath& path, int64_t seq, int64_t stamp_ns, const Eigen::Matrix4d& T_odom_body,
             const std::optional<Matrix6d>& covariance) {
            path.Insert(seq, stamp_ns, Eigen::Isometry3d(T_odom_body), covariance);
          },
          "seq"_a, "stamp_ns"_a, "T_odom_body"_a, "covariance"_a.none(),
          "Add a keyframe, with the covariance (6, 6) of the motion since seq - 1 if its robot "
          "sent\n"
          "one; raises ValueError when it is there already.")
      .def("num_after", &OdometryPath::NumAfter, "seq"_a,
           "How many keyframes follow on a sequence number.")
      .def("state", &OdometryPath::State, "last"_a,
           "As long as it stays equal, so do all motions and twists up to a keyframe.")
      .def(
          "covariance",
          [](const OdometryPath& path, int64_t first, int64_t last) -> RowMajor6d {
            return path.Covariance(first, last);
          },
          "first"_a, "last"_a,
          "(6, 6) covariance of the motion between two keyframes, in the later body frame.")
      .def(
          "twists", &OdometryPath::TwistsOf, "seq"_a,
          "(2, 6) how the body moved before and after a keyframe, [rad/s, m/s] in its frame; None\n"
          "without any neighbour at another time.");
}

}  // namespace

void BindOdometry(nb::module_& m) {
  nb::class_<OdometryNoise>(
      m, "OdometryNoise",
      "Accuracy of a front-end; each field is in core/include/covinz/odometry.h.")
      .def(
          "__init__",
          [](OdometryNoise* self, double rotation_per_sqrt_m, double rotation_per_sqrt_rad,
             double translation_per_sqrt_m, double translation_per_sqrt_rad, double min_rotation,
             double min_translation) {
            const OdometryNoise noise{rotation_per_sqrt_m,    rotation_per_sqrt_rad,
                                      translation_per_sqrt_m, translation_per_sqrt_rad,
                                      min_rotation,           min_translation};
            noise.Check();
            new (self) OdometryNoise(noise);
          },
          nb::kw_only(), "rotation_per_sqrt_m"_a, "rotation_per_sqrt_rad"_a,
          "translation_per_sqrt_m"_a, "translation_per_sqrt_rad"_a, "min_rotation"_a,
          "min_translation"_a, "Raises ValueError for a value out of range.");
  m.def(
      "random_walk",
      [](const Eigen::Matrix4d& T_a_b, const OdometryNoise& noise) -> RowMajor6d {
        return RandomWalk(Eigen::Isometry3d(T_a_b), noise);
      },
      "T_a_b"_a, "noise"_a,
      "(6, 6) covariance of a motion (4, 4) whose error grows with its metres and radians.");
  m.def("motion_covariance", &CovarianceOver, "T_odom_body"_a, "sent"_a, "noise"_a,
        R"((6, 6) covariance of the motion from the first of consecutive keyframes to the last.

Positive definite, whatever was sent.

Args:
    T_odom_body: N >= 1 odometry poses (4, 4) in order of time.
    sent: N - 1 covariances (6, 6) of the steps between them as their robot sent them; where it
        sent None, or what is no covariance, the front-end's usual accuracy stands in.
    noise: That accuracy; its floor is added once to a motion that needs it.

Raises:
    ValueError: If the numbers do not fit.)");
  BindPath(m);
}

}  // namespace covinz
