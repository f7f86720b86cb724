// Python: PoseGraphOptions, PoseGraphResult, optimize_pose_graph.
#include <algorithm>
#include <stdexcept>
#include <vector>

#include <nanobind/ndarray.h>

#include "bindings.h"
#include "covinz/pose_graph.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace covinz {
namespace {

template <typename Scalar, nb::ssize_t... Shape>
using In = nb::ndarray<const Scalar, nb::shape<Shape...>, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<nb::numpy, double, nb::c_contig>;
using RowMajor4d = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

Out ToNumpy(std::vector<double> values, std::initializer_list<size_t> shape) {
  auto* owned = new std::vector<double>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
  return Out(owned->data(), shape, owner);
}

Eigen::Isometry3d ToIsometry(const double* row_major) {
  Eigen::Isometry3d T;
  T.matrix() = Eigen::Map<const RowMajor4d>(row_major);
  return T;
}

void RequireLength(size_t length, size_t expected, const char* name) {
  if (length != expected) {
    throw std::invalid_argument(std::string("Pose graph: `") + name + "` has length " +
                                std::to_string(length) + ", expected " + std::to_string(expected));
  }
}

PoseGraph ToPoseGraph(const In<double, -1, 4, 4>& T_map_body,
                      const In<bool, -1>& fixed,
                      const In<int64_t, -1>& edge_from,
                      const In<int64_t, -1>& edge_to,
                      const In<double, -1, 4, 4>& T_from_to,
                      const In<double, -1, 6, 6>& information,
                      const In<bool, -1>& robust) {
  const size_t num_edges = edge_from.shape(0);
  RequireLength(edge_to.shape(0), num_edges, "edge_to");
  RequireLength(T_from_to.shape(0), num_edges, "T_from_to");
  RequireLength(information.shape(0), num_edges, "information");
  RequireLength(robust.shape(0), num_edges, "robust");
  PoseGraph graph;
  for (size_t i = 0; i < T_map_body.shape(0); ++i) {
    graph.T_map_body.push_back(ToIsometry(T_map_body.data() + 16 * i));
  }
  graph.fixed.assign(fixed.data(), fixed.data() + fixed.shape(0));
  for (size_t k = 0; k < num_edges; ++k) {
    const Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> W(information.data() +
                                                                           36 * k);
    graph.edges.push_back({edge_from.data()[k], edge_to.data()[k],
                           ToIsometry(T_from_to.data() + 16 * k), W, robust.data()[k]});
  }
  return graph;
}

Out Poses(const PoseGraphResult& result) {
  std::vector<double> values(16 * result.T_map_body.size());
  for (size_t i = 0; i < result.T_map_body.size(); ++i) {
    Eigen::Map<RowMajor4d>(values.data() + 16 * i) = result.T_map_body[i].matrix();
  }
  return ToNumpy(std::move(values), {result.T_map_body.size(), 4, 4});
}

PoseGraphResult Optimize(const In<double, -1, 4, 4>& T_map_body,
                         const In<bool, -1>& fixed,
                         const In<int64_t, -1>& edge_from,
                         const In<int64_t, -1>& edge_to,
                         const In<double, -1, 4, 4>& T_from_to,
                         const In<double, -1, 6, 6>& information,
                         const In<bool, -1>& robust,
                         const PoseGraphOptions& options) {
  const PoseGraph graph =
      ToPoseGraph(T_map_body, fixed, edge_from, edge_to, T_from_to, information, robust);
  nb::gil_scoped_release release;
  return OptimizePoseGraph(graph, options);
}

void BindOptions(nb::module_& m) {
  nb::class_<PoseGraphOptions>(m, "PoseGraphOptions", "Options of optimize_pose_graph.")
      .def(
          "__init__",
          [](PoseGraphOptions* self, double cauchy_scale, double cauchy_start_factor,
             int max_num_iterations, double function_tolerance, double parameter_tolerance,
             double gradient_tolerance) {
            new (self)
                PoseGraphOptions{cauchy_scale,       cauchy_start_factor, max_num_iterations,
                                 function_tolerance, parameter_tolerance, gradient_tolerance};
            self->Check();
          },
          nb::kw_only(), "cauchy_scale"_a = PoseGraphOptions().cauchy_scale,
          "cauchy_start_factor"_a = PoseGraphOptions().cauchy_start_factor,
          "max_num_iterations"_a = PoseGraphOptions().max_num_iterations,
          "function_tolerance"_a = PoseGraphOptions().function_tolerance,
          "parameter_tolerance"_a = PoseGraphOptions().parameter_tolerance,
          "gradient_tolerance"_a = PoseGraphOptions().gradient_tolerance)
      .def_ro("cauchy_scale", &PoseGraphOptions::cauchy_scale)
      .def_ro("cauchy_start_factor", &PoseGraphOptions::cauchy_start_factor)
      .def_ro("max_num_iterations", &PoseGraphOptions::max_num_iterations)
      .def_ro("function_tolerance", &PoseGraphOptions::function_tolerance)
      .def_ro("parameter_tolerance", &PoseGraphOptions::parameter_tolerance)
      .def_ro("gradient_tolerance", &PoseGraphOptions::gradient_tolerance);
}

void BindResult(nb::module_& m) {
  nb::class_<PoseGraphResult>(m, "PoseGraphResult", "Outcome of optimize_pose_graph.")
      .def_prop_ro("T_map_body", &Poses, nb::rv_policy::automatic,
                   "Optimised poses (N, 4, 4) [m]; fixed nodes exactly as given.")
      .def_ro("initial_cost", &PoseGraphResult::initial_cost, "Half the objective of eq. (1).")
      .def_ro("final_cost", &PoseGraphResult::final_cost, "Half the objective of eq. (1).")
      .def_ro("num_iterations", &PoseGraphResult::num_iterations)
      .def_ro("converged", &PoseGraphResult::converged,
              "False if max_num_iterations ended it; the poses are the best so far.")
      .def_prop_ro(
          "edge_chi2",
          [](const PoseGraphResult& result) {
            return ToNumpy(result.edge_chi2, {result.edge_chi2.size()});
          },
          nb::rv_policy::automatic,
          "Squared Mahalanobis error (M,) of every edge at the result, before the loss.");
}

}  // namespace

void BindPoseGraph(nb::module_& m) {
  BindOptions(m);
  BindResult(m);
  m.def("optimize_pose_graph", &Optimize, "T_map_body"_a, "fixed"_a, "edge_from"_a, "edge_to"_a,
        "T_from_to"_a, "information"_a, "robust"_a, "options"_a = PoseGraphOptions(),
        R"(Minimise equation (1) over the poses of all nodes that are not fixed.

Args:
    T_map_body: Initial poses (N, 4, 4), metres.
    fixed: Nodes (N,) that hold the gauge; every connected component needs one.
    edge_from: Node indices (M,); the candidate of a loop.
    edge_to: Node indices (M,); the query of a loop.
    T_from_to: Measured relative poses (M, 4, 4), metres.
    information: Inverse covariances (M, 6, 6) of T_from_to, right perturbation
        [rotation, translation] in the ``to`` body frame.
    robust: Edges (M,) under the Cauchy loss: True for loops, False for odometry.
    options: PoseGraphOptions.

Returns:
    PoseGraphResult. The same input gives the same bits.

Raises:
    ValueError: Lengths differ, an index is out of range, a number is not finite, a
        pose is not rigid, an information matrix is not symmetric positive definite,
        or a node is not connected to any fixed node.

Source: COVINS-G III-C, eq. (1).)");
}

}  // namespace covinz
