// From a graph to its optimum: checks, the passes of optimisation, and their outcome.
#include "covinz/pose_graph.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "levenberg_marquardt.h"
#include "pose_graph_objective.h"

namespace covinz {
namespace {

// A start needs no more than this.
constexpr double kStartFunctionTolerance = 1e-3;

}  // namespace

PoseGraphResult OptimizePoseGraph(const PoseGraph& graph, const PoseGraphOptions& options) {
  graph.Check();
  options.Check();
  const PoseGraphObjective objective(graph);
  PoseEstimate estimate;
  estimate.poses = objective.InitialPoses();
  PoseGraphResult result;
  result.initial_cost = objective.Cost(estimate.poses, options.cauchy_scale);
  if (!std::isfinite(result.initial_cost)) {
    throw std::invalid_argument("Pose graph: the cost of the initial poses is not finite");
  }
  LevenbergMarquardt minimizer(objective, options);
  if (options.cauchy_start_factor > 1.0) {
    minimizer.Minimize(options.cauchy_start_factor * options.cauchy_scale,
                       std::max(options.function_tolerance, kStartFunctionTolerance), &estimate);
  }
  minimizer.Minimize(options.cauchy_scale, options.function_tolerance, &estimate);

  result.final_cost = estimate.cost;
  result.converged = estimate.converged;
  result.num_iterations = estimate.num_iterations;
  result.edge_chi2 = objective.Chi2(estimate.poses);
  result.T_map_body = graph.T_map_body;
  for (size_t i = 0; i < graph.fixed.size(); ++i) {
    if (graph.fixed[i]) continue;
    result.T_map_body[i].linear() = estimate.poses[i].q.toRotationMatrix();
    result.T_map_body[i].translation() = estimate.poses[i].p;
  }
  return result;
}

}  // namespace covinz
