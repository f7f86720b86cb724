// Generated pose graphs with known poses: a robot spirals down a sphere, loops join the turns.
#pragma once

#include <cmath>
#include <random>
#include <vector>

#include "covinz/pose_graph.h"

namespace covinz {

// Seeded standard normal numbers, the same on every platform (Box-Muller).
class Gaussian {
 public:
  explicit Gaussian(uint64_t seed) : engine_(seed) {}
  double Draw() {
    const double u = (static_cast<double>(engine_() >> 11) + 0.5) * 0x1p-53;
    const double v = static_cast<double>(engine_() >> 11) * 0x1p-53;
    return std::sqrt(-2.0 * std::log(u)) * std::cos(2.0 * M_PI * v);
  }
  Vector6d Draw(double sigma_rad, double sigma_m) {
    Vector6d xi;
    for (int i = 0; i < 6; ++i) xi(i) = Draw() * (i < 3 ? sigma_rad : sigma_m);
    return xi;
  }

 private:
  std::mt19937_64 engine_;
};

struct PoseGraphProblem {
  std::vector<Eigen::Isometry3d> truth;
  PoseGraph graph;  // initial poses by composing the noisy odometry; node 0 fixed at its truth
};

inline Matrix6d InformationOf(double sigma_rad, double sigma_m) {
  Vector6d diagonal;
  diagonal << Eigen::Vector3d::Constant(1.0 / (sigma_rad * sigma_rad)),
      Eigen::Vector3d::Constant(1.0 / (sigma_m * sigma_m));
  return diagonal.asDiagonal();
}

// Noise of zero still gets the information of 1 mrad and 1 cm.
inline PoseGraphProblem SphereProblem(int turns, int nodes_per_turn, double noise, uint64_t seed) {
  const double sigma_rad = 1e-3;
  const double sigma_m = 1e-2;
  const int num_nodes = turns * nodes_per_turn;
  Gaussian gaussian(seed);
  PoseGraphProblem problem;
  for (int i = 0; i < num_nodes; ++i) {
    const double polar = M_PI * (i + nodes_per_turn) / (num_nodes + 2 * nodes_per_turn);
    const double azimuth = 2.0 * M_PI * i / nodes_per_turn;
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.rotate(Eigen::AngleAxisd(azimuth, Eigen::Vector3d::UnitZ()));
    T.rotate(Eigen::AngleAxisd(polar, Eigen::Vector3d::UnitY()));
    T.translate(Eigen::Vector3d(0.0, 0.0, 10.0));
    problem.truth.push_back(T);
  }
  const auto add_edge = [&](int from, int to, bool robust) {
    const Eigen::Isometry3d T =
        problem.truth[static_cast<size_t>(from)].inverse() * problem.truth[static_cast<size_t>(to)];
    problem.graph.edges.push_back({from, to, T * ExpSE3(noise * gaussian.Draw(sigma_rad, sigma_m)),
                                   InformationOf(sigma_rad, sigma_m), robust});
  };
  problem.graph.T_map_body = {problem.truth[0]};
  for (int i = 0; i + 1 < num_nodes; ++i) {
    add_edge(i, i + 1, false);
    problem.graph.T_map_body.push_back(problem.graph.T_map_body.back() *
                                       problem.graph.edges.back().T_from_to);
  }
  for (int i = 0; i + nodes_per_turn < num_nodes; ++i) add_edge(i, i + nodes_per_turn, true);
  problem.graph.fixed.assign(static_cast<size_t>(num_nodes), false);
  problem.graph.fixed[0] = true;
  return problem;
}

// Largest distance between two estimates of the same nodes, in the tangent (rad and m).
inline double MaxDistance(const std::vector<Eigen::Isometry3d>& a,
                          const std::vector<Eigen::Isometry3d>& b) {
  double distance = 0.0;
  for (size_t i = 0; i < a.size(); ++i) {
    distance = std::max(distance, LogSE3(a[i].inverse() * b[i]).norm());
  }
  return distance;
}

}  // namespace covinz
