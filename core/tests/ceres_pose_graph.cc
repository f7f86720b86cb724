// Equation (1) handed to Ceres.
#include "ceres_pose_graph.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include <ceres/ceres.h>
#include <Eigen/Cholesky>

#include "covinz/pose_graph_residual.h"

namespace covinz {
namespace {

// A pose as Ceres sees it: quaternion x, y, z, w, then translation.
constexpr int kPoseSize = 7;
using PoseParameters = std::array<double, kPoseSize>;
using RowMajorJacobian = Eigen::Matrix<double, 6, kPoseSize, Eigen::RowMajor>;

Eigen::Map<const Eigen::Quaterniond> Rotation(const double* pose) {
  return Eigen::Map<const Eigen::Quaterniond>(pose);
}

Eigen::Map<const Eigen::Vector3d> Translation(const double* pose) {
  return Eigen::Map<const Eigen::Vector3d>(pose + 4);
}

void Store(const Eigen::Quaterniond& q, const Eigen::Vector3d& p, double* pose) {
  Eigen::Map<Eigen::Vector4d>{pose} = q.coeffs();
  Eigen::Map<Eigen::Vector3d>{pose + 4} = p;
}

PoseParameters Pack(const Eigen::Isometry3d& T) {
  PoseParameters pose;
  Store(Eigen::Quaterniond(Eigen::Matrix3d(T.linear())).normalized(), T.translation(), pose.data());
  return pose;
}

Eigen::Isometry3d Unpack(const PoseParameters& pose) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Rotation(pose.data()).toRotationMatrix();
  T.translation() = Translation(pose.data());
  return T;
}

// The chart of se3.h for Ceres. PlusJacobian is [I; 0]: RelativePoseCost hands over Jacobians
// in the tangent, padded by a zero column, so that the product of the two is exact and no
// derivative with respect to a quaternion is ever formed.
class PoseManifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return kPoseSize; }
  int TangentSize() const override { return 6; }

  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override {
    const Eigen::Map<const Vector6d> xi(delta);
    Store((Rotation(x) * ExpSO3(xi.head<3>())).normalized(),
          Translation(x) + Rotation(x) * xi.tail<3>(), x_plus_delta);
    return true;
  }

  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, kPoseSize, 6, Eigen::RowMajor>>(jacobian).setIdentity();
    return true;
  }

  bool Minus(const double* y, const double* x, double* y_minus_x) const override {
    const Eigen::Quaterniond q_x_inverse = Rotation(x).conjugate();
    Eigen::Map<Vector6d>(y_minus_x) << LogSO3(Eigen::Quaterniond(q_x_inverse * Rotation(y))),
        q_x_inverse * (Translation(y) - Translation(x));
    return true;
  }

  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<RowMajorJacobian>(jacobian).setIdentity();
    return true;
  }
};

// L^T e of one edge, where W = L L^T, so that its squared norm is the edge's chi^2.
class RelativePoseCost final : public ceres::SizedCostFunction<6, kPoseSize, kPoseSize> {
 public:
  explicit RelativePoseCost(const PoseGraphEdge& edge)
      : T_from_to_(edge.T_from_to), sqrt_information_(edge.information.llt().matrixU()) {}

  bool Evaluate(double const* const* poses, double* residuals, double** jacobians) const override {
    const RelativePoseResidual residual =
        EvaluateRelativePose(Rotation(poses[0]), Translation(poses[0]), Rotation(poses[1]),
                             Translation(poses[1]), T_from_to_);
    Eigen::Map<Vector6d>(residuals).noalias() = sqrt_information_ * residual.error;
    if (jacobians == nullptr) return true;
    const std::array<const Matrix6d*, 2> tangents = {&residual.J_from, &residual.J_to};
    for (size_t i = 0; i < 2; ++i) {
      if (jacobians[i] == nullptr) continue;
      Eigen::Map<RowMajorJacobian> J(jacobians[i]);
      J.leftCols<6>().noalias() = sqrt_information_ * *tangents[i];
      J.col(6).setZero();
    }
    return true;
  }

 private:
  const Eigen::Isometry3d T_from_to_;
  const Matrix6d sqrt_information_;
};

std::vector<double> EdgeChi2(const std::vector<PoseGraphEdge>& edges,
                             const std::vector<PoseParameters>& poses) {
  std::vector<double> chi2;
  chi2.reserve(edges.size());
  for (const PoseGraphEdge& edge : edges) {
    const double* from = poses[static_cast<size_t>(edge.from)].data();
    const double* to = poses[static_cast<size_t>(edge.to)].data();
    const Vector6d error = EvaluateRelativePose(Rotation(from), Translation(from), Rotation(to),
                                                Translation(to), edge.T_from_to)
                               .error;
    chi2.push_back(error.dot(edge.information * error));
  }
  return chi2;
}

// Half the objective of equation (1).
double Cost(const std::vector<PoseGraphEdge>& edges,
            const std::vector<double>& chi2,
            double cauchy_scale) {
  const double a2 = cauchy_scale * cauchy_scale;
  double sum = 0.0;
  for (size_t k = 0; k < edges.size(); ++k) {
    sum += edges[k].robust ? a2 * std::log1p(chi2[k] / a2) : chi2[k];
  }
  return 0.5 * sum;
}

ceres::Solver::Options SolverOptions(const PoseGraphOptions& options) {
  ceres::Solver::Options solver;
  solver.minimizer_type = ceres::TRUST_REGION;
  solver.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
  solver.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  solver.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
  solver.num_threads = 1;
  solver.logging_type = ceres::SILENT;
  solver.max_num_iterations = options.max_num_iterations;
  solver.function_tolerance = options.function_tolerance;
  solver.parameter_tolerance = options.parameter_tolerance;
  solver.gradient_tolerance = options.gradient_tolerance;
  return solver;
}

struct Solution {
  std::vector<PoseParameters> poses;
  bool converged = false;
  int num_iterations = 0;
};

Solution Solve(const PoseGraph& graph,
               const PoseGraphOptions& options,
               const std::vector<PoseParameters>& initial) {
  Solution solution;
  solution.poses = initial;
  PoseManifold manifold;
  ceres::CauchyLoss cauchy(options.cauchy_scale);
  ceres::Problem::Options ownership;
  ownership.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ownership.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(ownership);
  for (size_t i = 0; i < initial.size(); ++i) {
    double* pose = solution.poses[i].data();
    problem.AddParameterBlock(pose, kPoseSize, &manifold);
    if (graph.fixed[i]) problem.SetParameterBlockConstant(pose);
  }
  for (const PoseGraphEdge& edge : graph.edges) {
    problem.AddResidualBlock(new RelativePoseCost(edge), edge.robust ? &cauchy : nullptr,
                             solution.poses[static_cast<size_t>(edge.from)].data(),
                             solution.poses[static_cast<size_t>(edge.to)].data());
  }
  ceres::Solver::Summary summary;
  ceres::Solve(SolverOptions(options), &problem, &summary);
  solution.converged = summary.termination_type == ceres::CONVERGENCE;
  // Ceres lists the initial evaluation as iteration 0; rejected steps count as iterations.
  solution.num_iterations = std::max(0, static_cast<int>(summary.iterations.size()) - 1);
  return solution;
}

}  // namespace

PoseGraphResult OptimizePoseGraphWithCeres(const PoseGraph& graph,
                                           const PoseGraphOptions& options) {
  graph.Check();
  options.Check();
  std::vector<PoseParameters> poses(graph.T_map_body.size());
  std::transform(graph.T_map_body.begin(), graph.T_map_body.end(), poses.begin(), Pack);

  PoseGraphResult result;
  result.initial_cost = Cost(graph.edges, EdgeChi2(graph.edges, poses), options.cauchy_scale);
  if (!std::isfinite(result.initial_cost)) {
    throw std::invalid_argument("Pose graph: the cost of the initial poses is not finite");
  }
  const Solution solution = Solve(graph, options, poses);

  result.converged = solution.converged;
  result.num_iterations = solution.num_iterations;
  result.edge_chi2 = EdgeChi2(graph.edges, solution.poses);
  result.final_cost = Cost(graph.edges, result.edge_chi2, options.cauchy_scale);
  result.T_map_body = graph.T_map_body;
  for (size_t i = 0; i < graph.fixed.size(); ++i) {
    if (!graph.fixed[i]) result.T_map_body[i] = Unpack(solution.poses[i]);
  }
  return result;
}

}  // namespace covinz
