// The same optimisation by Ceres: what OptimizePoseGraph is tested and measured against.
#pragma once

#include "covinz/pose_graph.h"

namespace covinz {

// As OptimizePoseGraph: Levenberg-Marquardt, analytic Jacobians, Eigen's sparse Cholesky, one
// thread.
PoseGraphResult OptimizePoseGraphWithCeres(const PoseGraph& graph, const PoseGraphOptions& options);

}  // namespace covinz
