// Equation (1) of the paper: its value, and its quadratic model around given poses.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "covinz/block_cholesky.h"
#include "covinz/pose_graph.h"
#include "covinz/se3.h"

namespace covinz {

// How the Hessian sees the Cauchy loss of a loop.
enum class Curvature {
  kReweighted,  // as a weight: it lies above the loss everywhere, so that steps are safe but short
  kConvex       // its second derivative too, as far as that leaves the loop's part positive
};

struct Pose {
  Eigen::Quaterniond q;  // unit
  Eigen::Vector3d p;
};

// Cost around given poses, in the tangent of se3.h of each free node: cost + g^T x + 1/2 x^T H x.
struct QuadraticModel {
  SymmetricBlockMatrix hessian;
  Eigen::VectorXd gradient;
};

// An edge's part of the quadratic model; its blocks are symmetric where their two nodes are one.
struct EdgeModel {
  Matrix6d from_from;
  Matrix6d from_to;
  Matrix6d to_to;
  Vector6d from;
  Vector6d to;
};

// e = Log(T_from_to^-1 * T_map_from^-1 * T_map_to).
Vector6d RelativePoseError(const Pose& from, const Pose& to, const Pose& measured);

// Gradient w J^T W e and Hessian J^T (w W + k W e e^T W) J of an edge; w = 1, k = 0 is
// Gauss-Newton on 1/2 e^T W e, and a loss rho(e^T W e) has w = rho', k = 2 rho''.
//
// Source: Triggs et al., "Bundle adjustment - a modern synthesis", 2000, section 4.3.
EdgeModel ModelOfEdge(
    const Pose& from, const Pose& to, const Pose& measured, const Matrix6d& W, double w, double k);

class PoseGraphObjective {
 public:
  // Keeps a reference to the graph.
  explicit PoseGraphObjective(const PoseGraph& graph);

  std::vector<Pose> InitialPoses() const;
  // Per edge, e^T W e.
  std::vector<double> Chi2(const std::vector<Pose>& poses) const;
  // Half the objective of equation (1).
  double Cost(const std::vector<Pose>& poses, double cauchy_scale) const;
  // A model with the right structure, of no values.
  QuadraticModel EmptyModel() const;
  void Linearize(const std::vector<Pose>& poses,
                 double cauchy_scale,
                 Curvature curvature,
                 QuadraticModel* model) const;
  // The poses perturbed by `step`, six entries per free node.
  std::vector<Pose> Moved(const std::vector<Pose>& poses, const Eigen::VectorXd& step) const;

 private:
  struct Edge {
    size_t from;
    size_t to;
    Pose measured;
    int32_t pair;     // of the model's blocks; negative where a node is fixed
    bool transposed;  // the block's row is `to`
  };

  void AddEdge(const EdgeModel& edge_model, const Edge& edge, QuadraticModel* model) const;

  const PoseGraph& graph_;
  size_t num_free_ = 0;
  std::vector<int32_t> free_index_;  // of each node; negative where fixed
  std::vector<std::pair<int32_t, int32_t>> pairs_;
  std::vector<Edge> edges_;
};

}  // namespace covinz
