// Levenberg-Marquardt on the objective of a pose graph.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "covinz/block_cholesky.h"
#include "covinz/pose_graph.h"
#include "pose_graph_objective.h"

namespace covinz {

struct PoseEstimate {
  std::vector<Pose> poses;
  double cost = 0.0;
  int num_iterations = 0;
  bool converged = false;
};

// The structure of the graph is analysed once for all minimisations.
class LevenbergMarquardt {
 public:
  // Keeps references to both.
  LevenbergMarquardt(const PoseGraphObjective& objective, const PoseGraphOptions& options);

  // Moves the poses to a minimum and counts iterations on.
  void Minimize(double cauchy_scale, double function_tolerance, PoseEstimate* estimate);

 private:
  struct Trial {
    double length = 1.0;  // times direction_
    std::vector<Pose> poses;
    double cost = 0.0;
  };

  bool GradientVanishes() const;
  bool DirectionVanishes(const std::vector<Pose>& poses) const;
  bool ComputeDirection();
  Trial TryLength(double length, const PoseEstimate& estimate) const;
  Trial SearchAlongDirection(const PoseEstimate& estimate) const;
  void Relinearize(Curvature curvature, const PoseEstimate& estimate);
  void Advance(double gain, double change, const PoseEstimate& estimate);
  void Retreat(const PoseEstimate& estimate);

  const PoseGraphObjective& objective_;
  const PoseGraphOptions& options_;
  QuadraticModel model_;
  BlockCholesky cholesky_;
  double cauchy_scale_ = 1.0;
  Curvature curvature_ = Curvature::kReweighted;
  double damping_ = 0.0;  // as a share of the Hessian's diagonal
  double growth_ = 0.0;   // of the damping when the next step fails
  Eigen::VectorXd direction_;
};

}  // namespace covinz
