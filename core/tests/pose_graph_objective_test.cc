// The quadratic model of a pose graph against residuals, Jacobians and finite differences.
#include "../src/pose_graph_objective.h"

#include <gtest/gtest.h>
#include <Eigen/Eigenvalues>

#include "covinz/pose_graph_residual.h"
#include "pose_graph_problem.h"

namespace covinz {
namespace {

Pose RandomPose(Gaussian* gaussian) {
  const Vector6d xi = gaussian->Draw(0.7, 2.0);
  return {ExpSO3(xi.head<3>()), xi.tail<3>()};
}

Matrix6d RandomInformation(Gaussian* gaussian) {
  Matrix6d root;
  for (double& entry : root.reshaped()) entry = gaussian->Draw();
  return root * root.transpose() + Matrix6d::Identity();
}

TEST(PoseGraphObjective, ModelOfAnEdgeIsThatOfItsJacobians) {
  Gaussian gaussian(1);
  for (int trial = 0; trial < 20; ++trial) {
    const Pose from = RandomPose(&gaussian);
    const Pose to = RandomPose(&gaussian);
    const Pose measured = RandomPose(&gaussian);
    Eigen::Isometry3d T_from_to = Eigen::Isometry3d::Identity();
    T_from_to.linear() = measured.q.toRotationMatrix();
    T_from_to.translation() = measured.p;
    const RelativePoseResidual residual =
        EvaluateRelativePose(from.q, from.p, to.q, to.p, T_from_to);
    const Matrix6d W = RandomInformation(&gaussian);
    const double w = 0.7;
    const double k = -0.01;
    const Vector6d We = W * residual.error;
    const Matrix6d V = w * W + k * We * We.transpose();
    const EdgeModel model = ModelOfEdge(from, to, measured, W, w, k);
    const double tolerance = 1e-12 * V.norm() * residual.J_from.squaredNorm();
    EXPECT_LT((RelativePoseError(from, to, measured) - residual.error).norm(), 1e-13);
    EXPECT_LT((model.from - w * residual.J_from.transpose() * We).norm(), tolerance);
    EXPECT_LT((model.to - w * residual.J_to.transpose() * We).norm(), tolerance);
    EXPECT_LT((model.from_from - residual.J_from.transpose() * V * residual.J_from).norm(),
              tolerance);
    EXPECT_LT((model.from_to - residual.J_from.transpose() * V * residual.J_to).norm(), tolerance);
    EXPECT_LT((model.to_to - residual.J_to.transpose() * V * residual.J_to).norm(), tolerance);
  }
}

// Dense Hessian of a model.
Eigen::MatrixXd Dense(const QuadraticModel& model) {
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(model.gradient.size(), model.gradient.size());
  for (size_t i = 0; i < model.hessian.diagonal.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(6 * i);
    H.block<6, 6>(at, at) = model.hessian.diagonal[i];
  }
  for (size_t k = 0; k < model.hessian.pairs.size(); ++k) {
    const auto& [column, row] = model.hessian.pairs[k];
    H.block<6, 6>(6 * row, 6 * column) = model.hessian.below[k];
    H.block<6, 6>(6 * column, 6 * row) = model.hessian.below[k].transpose();
  }
  return H;
}

TEST(PoseGraphObjective, GradientIsTheSlopeOfTheCost) {
  PoseGraphProblem problem = SphereProblem(3, 6, 1.0, 2);
  std::swap(problem.graph.edges[20].from, problem.graph.edges[20].to);
  problem.graph.fixed[7] = true;
  const PoseGraphObjective objective(problem.graph);
  const std::vector<Pose> poses = objective.InitialPoses();
  const double scale = 2.0;
  QuadraticModel model = objective.EmptyModel();
  objective.Linearize(poses, scale, Curvature::kReweighted, &model);
  ASSERT_EQ(model.gradient.size(), 6 * 16);
  for (Eigen::Index i = 0; i < model.gradient.size(); ++i) {
    const Eigen::VectorXd d = 1e-6 * Eigen::VectorXd::Unit(model.gradient.size(), i);
    const double slope = (objective.Cost(objective.Moved(poses, d), scale) -
                          objective.Cost(objective.Moved(poses, -d), scale)) /
                         2e-6;
    EXPECT_NEAR(model.gradient(i), slope, 1e-5 * model.gradient.cwiseAbs().maxCoeff());
  }
}

TEST(PoseGraphObjective, ConvexCurvatureLiesBetweenNoneAndTheWeights) {
  const PoseGraphProblem problem = SphereProblem(3, 6, 1.0, 3);
  const PoseGraphObjective objective(problem.graph);
  const std::vector<Pose> poses = objective.InitialPoses();
  QuadraticModel weights = objective.EmptyModel();
  QuadraticModel convex = objective.EmptyModel();
  objective.Linearize(poses, 2.0, Curvature::kReweighted, &weights);
  objective.Linearize(poses, 2.0, Curvature::kConvex, &convex);
  EXPECT_EQ(weights.gradient, convex.gradient);
  const Eigen::MatrixXd less = Dense(weights) - Dense(convex);
  const double norm = Dense(weights).norm();
  EXPECT_GT(less.norm(), 1e-6 * norm);
  const auto least = [](const Eigen::MatrixXd& H) {
    return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(H).eigenvalues().minCoeff();
  };
  EXPECT_GT(least(less), -1e-12 * norm);
  EXPECT_GT(least(Dense(convex)), 0.0);
}

}  // namespace
}  // namespace covinz
