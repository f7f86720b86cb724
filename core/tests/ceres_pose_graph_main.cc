// Command line of ceres_pose_graph.h, for benchmarks: a graph from standard input, in native byte
// order as written by benchmarks/ceres_reference.py, and the outcome to standard output.
#include <ctime>

#include <cstdint>
#include <iostream>
#include <stdexcept>
#include <vector>

#include "ceres_pose_graph.h"

namespace covinz {
namespace {

template <typename T>
std::vector<T> Read(size_t count) {
  std::vector<T> values(count);
  std::cin.read(reinterpret_cast<char*>(values.data()),
                static_cast<std::streamsize>(count * sizeof(T)));
  if (!std::cin) throw std::invalid_argument("Ceres reference: the input ends early");
  return values;
}

Eigen::Isometry3d Transform(const double* row_major) {
  Eigen::Isometry3d T;
  T.matrix() = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(row_major);
  return T;
}

// Numbers of nodes and edges; per node pose and whether fixed; per edge from, to, pose,
// information, whether robust.
PoseGraph ReadGraph() {
  const std::vector<int64_t> sizes = Read<int64_t>(2);
  const auto num_nodes = static_cast<size_t>(sizes.at(0));
  const auto num_edges = static_cast<size_t>(sizes.at(1));
  const std::vector<double> T_map_body = Read<double>(16 * num_nodes);
  const std::vector<uint8_t> fixed = Read<uint8_t>(num_nodes);
  const std::vector<int64_t> from = Read<int64_t>(num_edges);
  const std::vector<int64_t> to = Read<int64_t>(num_edges);
  const std::vector<double> T_from_to = Read<double>(16 * num_edges);
  const std::vector<double> information = Read<double>(36 * num_edges);
  const std::vector<uint8_t> robust = Read<uint8_t>(num_edges);
  PoseGraph graph;
  for (size_t i = 0; i < num_nodes; ++i) {
    graph.T_map_body.push_back(Transform(&T_map_body[16 * i]));
    graph.fixed.push_back(fixed[i] != 0);
  }
  for (size_t k = 0; k < num_edges; ++k) {
    graph.edges.push_back({from[k], to[k], Transform(&T_from_to[16 * k]),
                           Eigen::Map<const Matrix6d>(&information[36 * k]), robust[k] != 0});
  }
  return graph;
}

double CpuTime() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

// Options: Cauchy scale, most iterations. Outcome: initial and final cost, iterations, converged,
// CPU time [s], then the poses.
void Run() {
  const std::vector<double> numbers = Read<double>(2);
  PoseGraphOptions options;
  options.cauchy_scale = numbers[0];
  options.max_num_iterations = static_cast<int>(numbers[1]);
  const PoseGraph graph = ReadGraph();
  const double started = CpuTime();
  const PoseGraphResult result = OptimizePoseGraphWithCeres(graph, options);
  std::vector<double> outcome = {result.initial_cost, result.final_cost,
                                 static_cast<double>(result.num_iterations),
                                 result.converged ? 1.0 : 0.0, CpuTime() - started};
  for (const Eigen::Isometry3d& T : result.T_map_body) {
    const Eigen::Matrix4d transposed = T.matrix().transpose();
    outcome.insert(outcome.end(), transposed.data(), transposed.data() + 16);
  }
  std::cout.write(reinterpret_cast<const char*>(outcome.data()),
                  static_cast<std::streamsize>(outcome.size() * sizeof(double)));
}

}  // namespace
}  // namespace covinz

int main() {
  try {
    covinz::Run();
  } catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
  return 0;
}
