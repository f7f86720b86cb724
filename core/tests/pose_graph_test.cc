// Pose graph optimisation on problems with known poses and known costs.
#include "covinz/pose_graph.h"

#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <string>

#include <gtest/gtest.h>

#include "ceres_pose_graph.h"
#include "covinz/pose_graph_residual.h"
#include "pose_graph_problem.h"

namespace covinz {
namespace {

Eigen::Isometry3d Pose(double rx, double ry, double rz, double x, double y, double z) {
  return ExpSE3((Vector6d() << rx, ry, rz, x, y, z).finished());
}

Vector6d Error(const Eigen::Isometry3d& T_map_from,
               const Eigen::Isometry3d& T_map_to,
               const Eigen::Isometry3d& T_from_to) {
  return EvaluateRelativePose(Eigen::Quaterniond(T_map_from.linear()), T_map_from.translation(),
                              Eigen::Quaterniond(T_map_to.linear()), T_map_to.translation(),
                              T_from_to)
      .error;
}

// Two nodes on a line, `from` fixed at the origin and `to` starting at x.
PoseGraph LineGraph(double x) {
  PoseGraph graph;
  graph.T_map_body = {Eigen::Isometry3d::Identity(), Pose(0, 0, 0, x, 0, 0)};
  graph.fixed = {true, false};
  return graph;
}

// Iterates until the steps vanish: Levenberg-Marquardt's damping leaves 1e-4 of a first step.
PoseGraphOptions Exact() {
  PoseGraphOptions options;
  options.function_tolerance = 0.0;
  return options;
}

// Message of the std::invalid_argument that the graph provokes; empty if it is accepted.
std::string RejectionOf(const PoseGraph& graph, const PoseGraphOptions& options = {}) {
  try {
    OptimizePoseGraph(graph, options);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(PoseGraphResidual, IsThePerturbationOfTheMeasurement) {
  // An estimate off by xi in the `to` body frame has error xi, whatever the poses.
  const Eigen::Isometry3d T_map_from = Pose(0.3, -1.2, 0.5, 4, 5, 6);
  const Eigen::Isometry3d T_from_to = Pose(-0.7, 0.2, 1.9, 1, -2, 3);
  const Vector6d xi = (Vector6d() << 0.4, -0.2, 0.9, 0.5, -0.6, 0.7).finished();
  const Vector6d error = Error(T_map_from, T_map_from * T_from_to * ExpSE3(xi), T_from_to);
  EXPECT_LT((error - xi).norm(), 1e-14);
}

TEST(PoseGraphResidual, JacobiansMatchFiniteDifferences) {
  const Eigen::Isometry3d T_map_from = Pose(0.3, -1.2, 0.5, 4, 5, 6);
  const Eigen::Isometry3d T_from_to = Pose(-0.7, 0.2, 1.9, 1, -2, 3);
  const Eigen::Vector3d axis = Eigen::Vector3d(1, 2, -2) / 3.0;
  for (const double angle : {0.0, 1e-6, 0.1, 1.0, 2.5, 3.1}) {
    Vector6d xi;
    xi << angle * axis, 0.5, -0.6, 0.7;
    const Eigen::Isometry3d T_map_to = T_map_from * T_from_to * ExpSE3(xi);
    const RelativePoseResidual analytic = EvaluateRelativePose(
        Eigen::Quaterniond(T_map_from.linear()), T_map_from.translation(),
        Eigen::Quaterniond(T_map_to.linear()), T_map_to.translation(), T_from_to);
    const double h = 1e-6;
    for (int c = 0; c < 6; ++c) {
      const Vector6d d = h * Vector6d::Unit(c);
      const Vector6d column_from = (Error(T_map_from * ExpSE3(d), T_map_to, T_from_to) -
                                    Error(T_map_from * ExpSE3(-d), T_map_to, T_from_to)) /
                                   (2.0 * h);
      const Vector6d column_to = (Error(T_map_from, T_map_to * ExpSE3(d), T_from_to) -
                                  Error(T_map_from, T_map_to * ExpSE3(-d), T_from_to)) /
                                 (2.0 * h);
      EXPECT_LT((column_from - analytic.J_from.col(c)).norm(), 1e-7) << angle << " " << c;
      EXPECT_LT((column_to - analytic.J_to.col(c)).norm(), 1e-7) << angle << " " << c;
    }
  }
}

TEST(PoseGraph, WeighsTranslationsByInformation) {
  // 4 (x - 1)^2 + 1 (x - 1.5)^2 is least at 1.1, where half of it is 0.1; at x = 0 it is 3.125.
  PoseGraph graph = LineGraph(0.0);
  graph.edges = {{0, 1, Pose(0, 0, 0, 1.0, 0, 0), 4.0 * Matrix6d::Identity(), false},
                 {0, 1, Pose(0, 0, 0, 1.5, 0, 0), Matrix6d::Identity(), false}};
  const PoseGraphResult result = OptimizePoseGraph(graph, Exact());
  EXPECT_TRUE(result.converged);
  EXPECT_NEAR(result.initial_cost, 3.125, 1e-14);
  EXPECT_NEAR(result.final_cost, 0.1, 1e-12);
  EXPECT_LT((LogSE3(result.T_map_body[1]) - 1.1 * Vector6d::Unit(3)).norm(), 1e-6);
  ASSERT_EQ(result.edge_chi2.size(), 2u);
  EXPECT_NEAR(result.edge_chi2[0], 0.04, 1e-6);
  EXPECT_NEAR(result.edge_chi2[1], 0.16, 1e-6);
}

TEST(PoseGraph, WeighsRotationsByInformation) {
  PoseGraph graph = LineGraph(0.0);
  graph.edges = {{0, 1, Pose(0, 0, 1.0, 0, 0, 0), 4.0 * Matrix6d::Identity(), false},
                 {0, 1, Pose(0, 0, 1.5, 0, 0, 0), Matrix6d::Identity(), false}};
  const PoseGraphResult result = OptimizePoseGraph(graph, Exact());
  EXPECT_NEAR(result.final_cost, 0.1, 1e-12);
  EXPECT_LT((LogSE3(result.T_map_body[1]) - 1.1 * Vector6d::Unit(2)).norm(), 1e-6);
}

TEST(PoseGraph, CovarianceIsReadInTheFrameOfTheToBody) {
  // The `to` body looks along map y. Two measurements disagree along map x and y; the first is
  // sure along its own x (map y) only, so the result follows it in map y and the other in map x.
  PoseGraph graph = LineGraph(0.0);
  Vector6d sure_in_x = Vector6d::Constant(1.0);
  sure_in_x(3) = 1e6;
  sure_in_x(4) = 1e-6;
  graph.edges = {{0, 1, Pose(0, 0, M_PI / 2, 1, 1, 0), sure_in_x.asDiagonal(), false},
                 {0, 1, Pose(0, 0, M_PI / 2, 2, 2, 0), Matrix6d::Identity(), false}};
  const Eigen::Vector3d p = OptimizePoseGraph(graph, Exact()).T_map_body[1].translation();
  EXPECT_NEAR(p.x(), 2.0, 1e-5);
  EXPECT_NEAR(p.y(), 1.0, 1e-5);
}

TEST(PoseGraph, CauchyCostOfOneLoop) {
  // chi^2 = 2 (3 - 1)^2 = 8: 1/2 a^2 log(1 + 8 / a^2) for a = 1.5, and 4 without the loss.
  PoseGraph graph = LineGraph(3.0);
  graph.fixed[1] = true;
  graph.edges = {{0, 1, Pose(0, 0, 0, 1, 0, 0), 2.0 * Matrix6d::Identity(), true}};
  PoseGraphOptions options;
  options.cauchy_scale = 1.5;
  const PoseGraphResult robust = OptimizePoseGraph(graph, options);
  EXPECT_NEAR(robust.initial_cost, 0.5 * 2.25 * std::log(1.0 + 8.0 / 2.25), 1e-14);
  EXPECT_EQ(robust.final_cost, robust.initial_cost);
  EXPECT_NEAR(robust.edge_chi2[0], 8.0, 1e-14);
  graph.edges[0].robust = false;
  EXPECT_NEAR(OptimizePoseGraph(graph, options).final_cost, 4.0, 1e-14);
}

TEST(PoseGraph, CauchyStationaryPoint) {
  // The derivative of 1/2 x^2 + 1/2 log(1 + (x - 1)^2) vanishes.
  PoseGraph graph = LineGraph(0.0);
  graph.edges = {{0, 1, Pose(0, 0, 0, 0, 0, 0), Matrix6d::Identity(), false},
                 {0, 1, Pose(0, 0, 0, 1, 0, 0), Matrix6d::Identity(), true}};
  PoseGraphOptions options = Exact();
  options.cauchy_scale = 1.0;
  const double x = OptimizePoseGraph(graph, options).T_map_body[1].translation().x();
  EXPECT_GT(x, 0.3);
  EXPECT_LT(x, 0.5);
  EXPECT_NEAR(x + (x - 1.0) / (1.0 + (x - 1.0) * (x - 1.0)), 0.0, 1e-7);
}

TEST(PoseGraph, RecoversTheTruthFromExactEdges) {
  PoseGraphProblem problem = SphereProblem(6, 20, 0.0, 1);
  Gaussian gaussian(2);
  for (size_t i = 1; i < problem.truth.size(); ++i) {
    problem.graph.T_map_body[i] = problem.truth[i] * ExpSE3(gaussian.Draw(0.2, 0.5));
  }
  PoseGraphOptions options;
  options.cauchy_scale = 1e3;  // the start is far: keep the loops' pull
  const PoseGraphResult result = OptimizePoseGraph(problem.graph, options);
  EXPECT_TRUE(result.converged);
  EXPECT_GT(result.initial_cost, 1e4);
  EXPECT_LT(result.final_cost, 1e-8);
  EXPECT_LT(MaxDistance(problem.truth, result.T_map_body), 1e-6);
}

TEST(PoseGraph, NoisyEdgesLeaveTheExpectedChi2) {
  PoseGraphProblem problem = SphereProblem(8, 25, 1.0, 3);
  for (PoseGraphEdge& edge : problem.graph.edges) edge.robust = false;
  const PoseGraphResult result = OptimizePoseGraph(problem.graph, {});
  const double dof =
      6.0 * static_cast<double>(problem.graph.edges.size() - problem.truth.size() + 1);
  // chi^2 has mean dof and standard deviation sqrt(2 dof): four of them.
  EXPECT_NEAR(2.0 * result.final_cost, dof, 4.0 * std::sqrt(2.0 * dof));
  EXPECT_LT(MaxDistance(problem.truth, result.T_map_body),
            0.5 * MaxDistance(problem.truth, problem.graph.T_map_body));
}

TEST(PoseGraph, GaugeInvariant) {
  const PoseGraphProblem problem = SphereProblem(5, 16, 1.0, 4);
  const Eigen::Isometry3d T_new_map = Pose(0.5, -2.0, 1.0, 30, -20, 10);
  PoseGraph moved = problem.graph;
  for (Eigen::Isometry3d& T : moved.T_map_body) T = T_new_map * T;
  PoseGraphResult result = OptimizePoseGraph(problem.graph, {});
  const PoseGraphResult moved_result = OptimizePoseGraph(moved, {});
  for (Eigen::Isometry3d& T : result.T_map_body) T = T_new_map * T;
  EXPECT_NEAR(result.final_cost, moved_result.final_cost, 1e-7 * result.final_cost);
  EXPECT_LT(MaxDistance(result.T_map_body, moved_result.T_map_body), 1e-5);
}

TEST(PoseGraph, ReversedEdgesGiveTheSamePoses) {
  // Cov(T_to_from) = Ad Cov(T_from_to) Ad^T with Ad of T_from_to, to first order in the noise.
  const PoseGraphProblem problem = SphereProblem(5, 16, 0.1, 5);
  PoseGraph reversed = problem.graph;
  for (PoseGraphEdge& edge : reversed.edges) {
    const Matrix6d Ad_inverse = AdjointSE3(edge.T_from_to.inverse());
    std::swap(edge.from, edge.to);
    const Matrix6d W = Ad_inverse.transpose() * edge.information * Ad_inverse;
    edge.information = 0.5 * (W + W.transpose());
    edge.T_from_to = edge.T_from_to.inverse();
  }
  const PoseGraphResult result = OptimizePoseGraph(problem.graph, {});
  const PoseGraphResult reversed_result = OptimizePoseGraph(reversed, {});
  EXPECT_NEAR(result.final_cost, reversed_result.final_cost, 1e-3 * result.final_cost);
  EXPECT_LT(MaxDistance(result.T_map_body, reversed_result.T_map_body),
            0.01 * MaxDistance(result.T_map_body, problem.truth));
}

TEST(PoseGraph, CauchySuppressesWrongLoops) {
  PoseGraphProblem problem = SphereProblem(6, 20, 1.0, 6);
  const double without =
      MaxDistance(problem.truth, OptimizePoseGraph(problem.graph, {}).T_map_body);
  const size_t wrong = problem.graph.edges.size();
  problem.graph.edges.push_back(
      {10, 90, Pose(0.3, 0, 0, 1, 1, 0), InformationOf(1e-3, 1e-2), true});
  problem.graph.edges.push_back(
      {30, 115, Pose(0, 0.5, 0, 0, 0, 0), InformationOf(1e-3, 1e-2), true});
  const PoseGraphResult robust = OptimizePoseGraph(problem.graph, {});
  EXPECT_LT(MaxDistance(problem.truth, robust.T_map_body), 1.5 * without);
  EXPECT_GT(robust.edge_chi2[wrong], 1e4);
  EXPECT_GT(robust.edge_chi2[wrong + 1], 1e4);
  for (PoseGraphEdge& edge : problem.graph.edges) edge.robust = false;
  EXPECT_GT(MaxDistance(problem.truth, OptimizePoseGraph(problem.graph, {}).T_map_body),
            20.0 * without);
}

// Random loops, some of them wrong by metres, on the spiral's odometry.
PoseGraph GraphWithWrongLoops(int num_loops, int num_wrong, uint64_t seed) {
  PoseGraphProblem problem = SphereProblem(8, 15, 1.0, seed);
  std::mt19937_64 engine(seed + 1);
  Gaussian gaussian(seed + 2);
  const uint64_t num_nodes = problem.truth.size();
  for (int k = 0; k < num_loops; ++k) {
    const auto from = static_cast<int64_t>(engine() % num_nodes);
    const auto to = static_cast<int64_t>((from + 5 + engine() % (num_nodes - 10)) % num_nodes);
    const Vector6d error = k < num_wrong ? gaussian.Draw(0.3, 3.0) : gaussian.Draw(1e-3, 1e-2);
    const Eigen::Isometry3d T =
        problem.truth[static_cast<size_t>(from)].inverse() * problem.truth[static_cast<size_t>(to)];
    problem.graph.edges.push_back({from, to, T * ExpSE3(error), InformationOf(1e-3, 1e-2), true});
  }
  return problem.graph;
}

TEST(PoseGraph, ReachesTheMinimumThatCeresDoes) {
  uint64_t seed = 20;
  for (const int num_loops : {0, 20, 200, 600}) {
    for (const double wrong : {0.0, 0.1, 0.3}) {
      const PoseGraph graph =
          GraphWithWrongLoops(num_loops, static_cast<int>(wrong * num_loops), seed++);
      PoseGraphOptions options;
      // Ceres converges linearly on a Cauchy loss: it gets there with a smaller tolerance only.
      options.function_tolerance = 1e-12;
      options.cauchy_scale = 10.0;
      PoseGraph wide = graph;
      wide.T_map_body = OptimizePoseGraphWithCeres(graph, options).T_map_body;
      options.cauchy_scale = 2.5;
      const PoseGraphResult ceres = OptimizePoseGraphWithCeres(wide, options);
      const PoseGraphResult ours = OptimizePoseGraph(wide, options);
      EXPECT_TRUE(ours.converged);
      EXPECT_NEAR(ours.initial_cost, ceres.initial_cost, 1e-9 * ceres.initial_cost);
      EXPECT_NEAR(ours.final_cost, ceres.final_cost, 1e-7 * ceres.final_cost)
          << num_loops << " loops, wrong " << wrong;
      EXPECT_LT(MaxDistance(ours.T_map_body, ceres.T_map_body), 1e-4);
    }
  }
}

TEST(PoseGraph, StopsNoLaterThanCeres) {
  uint64_t seed = 40;
  for (const double wrong : {0.0, 0.2}) {
    const PoseGraph graph = GraphWithWrongLoops(200, static_cast<int>(wrong * 200), seed++);
    const PoseGraphResult ceres = OptimizePoseGraphWithCeres(graph, {});
    const PoseGraphResult ours = OptimizePoseGraph(graph, {});
    EXPECT_TRUE(ours.converged);
    EXPECT_LE(ours.final_cost, ceres.final_cost * (1.0 + 1e-6));
    EXPECT_LE(ours.num_iterations, ceres.num_iterations);
  }
}

TEST(PoseGraph, WideStartIsTheSameAsTwoOptimisations) {
  const PoseGraph graph = GraphWithWrongLoops(200, 40, 50);
  PoseGraphOptions options;
  options.cauchy_start_factor = 4.0;
  const PoseGraphResult at_once = OptimizePoseGraph(graph, options);
  PoseGraphOptions start;
  start.cauchy_scale = 4.0 * options.cauchy_scale;
  start.function_tolerance = 1e-3;
  PoseGraph wide = graph;
  const PoseGraphResult first = OptimizePoseGraph(graph, start);
  wide.T_map_body = first.T_map_body;
  const PoseGraphResult second = OptimizePoseGraph(wide, {});
  EXPECT_EQ(at_once.num_iterations, first.num_iterations + second.num_iterations);
  EXPECT_NEAR(at_once.final_cost, second.final_cost, 1e-9 * second.final_cost);
  EXPECT_EQ(at_once.initial_cost, OptimizePoseGraph(graph, {}).initial_cost);
  EXPECT_LT(MaxDistance(at_once.T_map_body, second.T_map_body), 1e-9);
}

TEST(PoseGraph, FixedNodesAreReturnedBitByBit) {
  PoseGraphProblem problem = SphereProblem(3, 10, 1.0, 7);
  problem.graph.fixed[17] = true;
  const PoseGraphResult result = OptimizePoseGraph(problem.graph, {});
  for (const size_t i : {size_t{0}, size_t{17}}) {
    EXPECT_EQ(result.T_map_body[i].matrix(), problem.graph.T_map_body[i].matrix());
  }
  EXPECT_NE(result.T_map_body[16].matrix(), problem.graph.T_map_body[16].matrix());
}

TEST(PoseGraph, SameInputSameBits) {
  const PoseGraphProblem problem = SphereProblem(6, 20, 1.0, 8);
  const PoseGraphResult first = OptimizePoseGraph(problem.graph, {});
  const PoseGraphResult second = OptimizePoseGraph(problem.graph, {});
  for (size_t i = 0; i < first.T_map_body.size(); ++i) {
    EXPECT_EQ(first.T_map_body[i].matrix(), second.T_map_body[i].matrix());
  }
  EXPECT_EQ(first.final_cost, second.final_cost);
  EXPECT_EQ(first.edge_chi2, second.edge_chi2);
}

TEST(PoseGraph, IterationLimitIsReported) {
  const PoseGraphProblem problem = SphereProblem(6, 20, 1.0, 9);
  PoseGraphOptions options;
  options.max_num_iterations = 1;
  const PoseGraphResult result = OptimizePoseGraph(problem.graph, options);
  EXPECT_FALSE(result.converged);
  EXPECT_EQ(result.num_iterations, 1);
  EXPECT_LT(result.final_cost, result.initial_cost);
}

TEST(PoseGraph, EmptyAndEdgelessGraphs) {
  EXPECT_TRUE(OptimizePoseGraph(PoseGraph(), {}).converged);
  PoseGraph graph = LineGraph(1.0);
  graph.fixed[1] = true;
  const PoseGraphResult result = OptimizePoseGraph(graph, {});
  EXPECT_TRUE(result.converged);
  EXPECT_EQ(result.final_cost, 0.0);
  EXPECT_EQ(result.T_map_body[1].translation().x(), 1.0);
}

TEST(PoseGraph, SeparateComponentsEachNeedAFixedNode) {
  PoseGraph graph = LineGraph(0.5);
  graph.edges = {{0, 1, Pose(0, 0, 0, 1, 0, 0), Matrix6d::Identity(), false}};
  graph.T_map_body.push_back(Pose(0, 0, 0, 9, 9, 9));
  graph.fixed.push_back(false);
  EXPECT_NE(RejectionOf(graph).find("node 2 is not connected to any fixed node"),
            std::string::npos);
  graph.fixed[2] = true;
  EXPECT_EQ(RejectionOf(graph), "");
}

TEST(PoseGraph, MalformedInputIsNamed) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  PoseGraph good = LineGraph(0.5);
  good.edges = {{0, 1, Pose(0, 0, 0, 1, 0, 0), Matrix6d::Identity(), false}};
  ASSERT_EQ(RejectionOf(good), "");
  const auto expect = [&](const std::string& message, const auto& spoil) {
    PoseGraph graph = good;
    spoil(graph);
    EXPECT_NE(RejectionOf(graph).find(message), std::string::npos)
        << "expected '" << message << "', got '" << RejectionOf(graph) << "'";
  };
  expect("one entry per node", [](PoseGraph& g) { g.fixed.pop_back(); });
  expect("edge 0 names node 2", [](PoseGraph& g) { g.edges[0].to = 2; });
  expect("edge 0 names node -1", [](PoseGraph& g) { g.edges[0].from = -1; });
  expect("joins node 1 to itself", [](PoseGraph& g) { g.edges[0].from = 1; });
  expect("pose of node 1 is not finite", [&](PoseGraph& g) { g.T_map_body[1](0, 3) = nan; });
  expect("not a rigid", [](PoseGraph& g) { g.T_map_body[1].linear() *= 1.01; });
  expect("not a rigid", [](PoseGraph& g) { g.T_map_body[1].linear() *= -1.0; });
  expect("T_from_to of edge 0", [&](PoseGraph& g) { g.edges[0].T_from_to(1, 1) = nan; });
  expect("information of edge 0 is not finite",
         [&](PoseGraph& g) { g.edges[0].information(2, 3) = nan; });
  expect("positive definite", [](PoseGraph& g) { g.edges[0].information(5, 5) = 0.0; });
  expect("positive definite", [](PoseGraph& g) { g.edges[0].information(5, 5) = -1.0; });
  expect("symmetric", [](PoseGraph& g) { g.edges[0].information(0, 5) = 0.5; });
  expect("cost of the initial poses is not finite",
         [](PoseGraph& g) { g.edges[0].T_from_to(0, 3) = 1e200; });
}

TEST(PoseGraph, MalformedOptionsAreRejected) {
  PoseGraphOptions options;
  options.cauchy_scale = 0.0;
  EXPECT_NE(RejectionOf(PoseGraph(), options), "");
  options = {};
  options.cauchy_start_factor = 0.5;
  EXPECT_NE(RejectionOf(PoseGraph(), options), "");
  options = {};
  options.max_num_iterations = -1;
  EXPECT_NE(RejectionOf(PoseGraph(), options), "");
  options = {};
  options.function_tolerance = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NE(RejectionOf(PoseGraph(), options), "");
}

}  // namespace
}  // namespace covinz
