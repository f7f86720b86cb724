// Input checks of pose graph optimisation.
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "covinz/pose_graph.h"

namespace covinz {
namespace {

void Require(bool condition, const std::string& message) {
  if (!condition) throw std::invalid_argument("Pose graph: " + message);
}

void CheckPose(const Eigen::Isometry3d& T, const std::string& name) {
  // Poses pass through files and float arithmetic: rigid to 1e-6.
  constexpr double kTolerance = 1e-6;
  Require(T.matrix().allFinite(), name + " is not finite");
  const Eigen::Matrix3d R = T.linear();
  const bool rigid = (R.transpose() * R - Eigen::Matrix3d::Identity()).norm() < kTolerance &&
                     R.determinant() > 0.0 &&
                     T.matrix().row(3) == Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0);
  Require(rigid, name + " is not a rigid transform");
}

void CheckInformation(const Matrix6d& W, const std::string& name) {
  Require(W.allFinite(), name + " is not finite");
  const bool symmetric =
      (W - W.transpose()).cwiseAbs().maxCoeff() <= 1e-9 * W.cwiseAbs().maxCoeff();
  const bool positive_definite = Eigen::LLT<Matrix6d>(W).info() == Eigen::Success;
  Require(symmetric && positive_definite, name + " is not symmetric positive definite");
}

// Union-find over the nodes, with path halving.
class Components {
 public:
  explicit Components(size_t num_nodes) : parent_(num_nodes) {
    std::iota(parent_.begin(), parent_.end(), size_t{0});
  }
  size_t Root(size_t node) {
    while (parent_[node] != node) node = parent_[node] = parent_[parent_[node]];
    return node;
  }
  void Join(size_t a, size_t b) { parent_[Root(a)] = Root(b); }

 private:
  std::vector<size_t> parent_;
};

void CheckGauge(const PoseGraph& graph) {
  const size_t num_nodes = graph.T_map_body.size();
  Components components(num_nodes);
  for (const PoseGraphEdge& edge : graph.edges) {
    components.Join(static_cast<size_t>(edge.from), static_cast<size_t>(edge.to));
  }
  std::vector<bool> anchored(num_nodes, false);
  for (size_t i = 0; i < num_nodes; ++i) {
    if (graph.fixed[i]) anchored[components.Root(i)] = true;
  }
  for (size_t i = 0; i < num_nodes; ++i) {
    Require(anchored[components.Root(i)],
            "node " + std::to_string(i) + " is not connected to any fixed node");
  }
}

}  // namespace

void PoseGraph::Check() const {
  Require(fixed.size() == T_map_body.size(), "`fixed` must have one entry per node");
  for (size_t i = 0; i < T_map_body.size(); ++i) {
    CheckPose(T_map_body[i], "pose of node " + std::to_string(i));
  }
  const int64_t num_nodes = static_cast<int64_t>(T_map_body.size());
  for (size_t k = 0; k < edges.size(); ++k) {
    const PoseGraphEdge& edge = edges[k];
    const std::string name = "edge " + std::to_string(k);
    for (const int64_t node : {edge.from, edge.to}) {
      Require(node >= 0 && node < num_nodes,
              name + " names node " + std::to_string(node) + " of " + std::to_string(num_nodes));
    }
    Require(edge.from != edge.to, name + " joins node " + std::to_string(edge.to) + " to itself");
    CheckPose(edge.T_from_to, "T_from_to of " + name);
    CheckInformation(edge.information, "information of " + name);
  }
  CheckGauge(*this);
}

void PoseGraphOptions::Check() const {
  Require(std::isfinite(cauchy_scale) && cauchy_scale > 0.0, "cauchy_scale must be positive");
  Require(std::isfinite(cauchy_start_factor) && cauchy_start_factor >= 1.0,
          "cauchy_start_factor must not be below one");
  Require(max_num_iterations >= 0, "max_num_iterations must not be negative");
  for (const double tolerance : {function_tolerance, parameter_tolerance, gradient_tolerance}) {
    Require(std::isfinite(tolerance) && tolerance >= 0.0, "tolerances must not be negative");
  }
}

}  // namespace covinz
