// Pose graph optimisation: equation (1) of the paper.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/se3.h"

namespace covinz {

// A measured relative pose between two nodes: odometry, or a loop (from = cand, to = query).
struct PoseGraphEdge {
  int64_t from = 0;
  int64_t to = 0;
  Eigen::Isometry3d T_from_to = Eigen::Isometry3d::Identity();
  // Inverse covariance of T_from_to in the tangent of se3.h, so in the `to` body frame.
  Matrix6d information = Matrix6d::Identity();
  // Loop edges are robust (Cauchy), odometry edges are not. [paper III-C, eq. (1)]
  bool robust = false;
};

struct PoseGraph {
  std::vector<Eigen::Isometry3d> T_map_body;  // initial estimate, one per node
  std::vector<bool> fixed;                    // nodes that hold the gauge
  std::vector<PoseGraphEdge> edges;

  // Throws std::invalid_argument, naming the node or edge, where sizes differ, an index is out
  // of range, an edge joins a node to itself, a number is not finite, a pose is not rigid, an
  // information matrix is not symmetric positive definite, or a connected component of the
  // graph has no fixed node (its pose would be undetermined).
  void Check() const;
};

// Options of OptimizePoseGraph.
struct PoseGraphOptions {
  // Scale a of the Cauchy loss rho(s) = a^2 log(1 + s / a^2) on the loop edges' chi^2. A true
  // loop's chi^2 is 6 on average, so a = 1 gives it a seventh of its weight.
  // [benchmarks/cauchy_scale.py, two seeds: 2.5 stays within 4 % of the best scale with 0 to 50 %
  // of wrong loops, 1 within 30 %, 0.5 within 74 %; the paper names none, its public code uses 0.5]
  double cauchy_scale = 2.5;
  // The Cauchy loss has a minimum at "this loop is wrong" too, in which a true loop that closes
  // much drift can be caught; so poses are first optimised, to 1e-3 of the cost, with a scale so
  // many times wider. 1: not at all. [Blake and Zisserman, "Visual reconstruction", 1987; the
  // optimizer's configuration says what it uses]
  double cauchy_start_factor = 1.0;
  // Of each of the two. [the public code stops at 10, which large loops exceed]
  int max_num_iterations = 100;
  // Converged when an iteration lowers the cost by less than this share of it. [Ceres]
  double function_tolerance = 1e-6;
  // Converged when a step is shorter than this share of the state. [Ceres]
  double parameter_tolerance = 1e-8;
  // Converged when no component of the gradient is larger. [Ceres]
  double gradient_tolerance = 1e-10;

  void Check() const;  // throws std::invalid_argument
};

struct PoseGraphResult {
  std::vector<Eigen::Isometry3d> T_map_body;  // fixed nodes are returned bit by bit as given
  double initial_cost = 0.0;                  // half the objective of equation (1)
  double final_cost = 0.0;
  int num_iterations = 0;         // steps tried, each a factorisation
  bool converged = false;         // false: the best poses of max_num_iterations
  std::vector<double> edge_chi2;  // per edge, e^T W e at the result, before the loss
};

// Minimises 1/2 { sum_odometry e^T W e + sum_loops rho(e^T W e) } over the poses of the nodes
// that are not fixed, e as in pose_graph_residual.h.
//
// Levenberg-Marquardt on the sparse block Cholesky factorisation of block_cholesky.h, one thread:
// the same input gives the same bits on the same instruction set. First iterations weigh each loop
// by its loss, later ones know the loss's curvature too (pose_graph_objective.h) and so converge
// faster; along each step the length is fitted, as costs take a fiftieth of a factorisation.
//
// Source: COVINS-G, III-C, eq. (1).
//
// Throws std::invalid_argument on malformed input (see Check) or a cost that is not finite.
PoseGraphResult OptimizePoseGraph(const PoseGraph& graph, const PoseGraphOptions& options);

}  // namespace covinz
