// Variance components of keypoint errors and the covariance that follows from them.
#include "rig_covariance.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <vector>

#include <Eigen/Cholesky>

namespace covinz {
namespace {

// Side of a cell of an image [rad]: about a twentieth of the image of an ordinary camera; within
// one, errors count as equal.
constexpr double kCellSize_rad = 0.3;

// Distances over which a shared error fades [rad], from a few cells to the image: nothing is known
// about them, so every octave counts alike.
constexpr double kSharedLengths_rad[] = {0.15, 0.3, 0.6, 1.2};

// A normal two-dimensional error with a Cauchy loss: E[w s] / E[s] as a function of the loss, so
// that the weighted residuals of normal errors have the variance of the errors. With x = loss^2 /
// 2: x (1 - x exp(x) E1(x)).
double WeightedVariance(double loss2) {
  const double x = 0.5 * loss2;
  // exp(x) E1(x) by its continued fraction (Abramowitz and Stegun 5.1.22), from far down.
  double fraction = x;
  for (int k = 60; k > 0; --k) fraction = x + k / (1.0 + k / fraction);
  return x * (1.0 - x / fraction);
}

using Cell = std::tuple<int, int, int>;  // camera, and position in the image as two angles

Cell CellOf(const BearingMeasurement& measured) {
  const Eigen::Vector3d& z = measured.bearing;
  const double across = std::atan2(z.x(), z.z());
  const double down = std::atan2(z.y(), std::hypot(z.x(), z.z()));
  return {measured.camera, static_cast<int>(std::floor(across / kCellSize_rad)),
          static_cast<int>(std::floor(down / kCellSize_rad))};
}

// The cells with keypoints, by camera, and the cell of each observation.
struct Cells {
  std::vector<Cell> cells;
  std::vector<int> of_observation;
};

Cells FindCells(const RigAdjustment& problem) {
  Cells result;
  std::map<Cell, int> numbers;
  for (const BearingMeasurement& measured : problem.observations) numbers[CellOf(measured)] = 0;
  for (auto& [cell, number] : numbers) {
    number = static_cast<int>(result.cells.size());
    result.cells.push_back(cell);
  }
  for (const BearingMeasurement& measured : problem.observations) {
    result.of_observation.push_back(numbers[CellOf(measured)]);
  }
  return result;
}

// Q: correlation of the shared errors of two cells, 2 x 2 for each pair of cells.
Eigen::MatrixXd CellCorrelation(const std::vector<Cell>& cells) {
  const Eigen::Index n = static_cast<Eigen::Index>(cells.size());
  Eigen::MatrixXd Q = Eigen::MatrixXd::Zero(2 * n, 2 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j) {
      const auto& [camera_i, x_i, y_i] = cells[static_cast<size_t>(i)];
      const auto& [camera_j, x_j, y_j] = cells[static_cast<size_t>(j)];
      if (camera_i != camera_j) continue;
      const double distance = kCellSize_rad * std::hypot(x_i - x_j, y_i - y_j);
      double correlation = 0.0;
      for (const double length : kSharedLengths_rad) {
        correlation += std::exp(-0.5 * std::pow(distance / length, 2)) / 4.0;
      }
      Q.block<2, 2>(2 * i, 2 * j) = correlation * Eigen::Matrix2d::Identity();
    }
  }
  return Q;
}

// Everything that the variance components are made of, before the cameras are fitted.
struct CellSums {
  Eigen::MatrixXd coupling;  // A: camera unknowns x cell errors
  Eigen::MatrixXd kernel;    // C^T M C with M of the points alone
  Eigen::VectorXd residual;  // C^T e
  double residual2 = 0.0;    // e^T e
  double dof = 0.0;          // tr(M) of the points alone
};

// An observation of the track at hand: Jacobians, residual and cell, by the root of its weight.
struct Row {
  Eigen::Matrix<double, 2, 6> J_cam;
  Eigen::Matrix<double, 2, 3> J_point;
  Eigen::Vector2d error;
  double root_weight;
  Eigen::Index camera;  // its first unknown, negative for camera 0
  Eigen::Index cell;    // its first cell error
};

std::vector<Row> RowsOf(const RigAdjustment& problem,
                        const RigAdjustmentState& state,
                        const std::vector<int>& cells,
                        size_t track) {
  const InverseDistancePoint& point = state.points[track];
  const Eigen::Matrix<double, 2, 3> basis = TangentBasis(point.direction);
  std::vector<Row> rows;
  for (int i = problem.begins[track]; i < problem.begins[track + 1]; ++i) {
    const size_t n = static_cast<size_t>(i);
    const BearingMeasurement& measured = problem.observations[n];
    const BearingResidual residual = EvaluateBearing(
        measured, point, basis, state.T_world_cam[static_cast<size_t>(measured.camera)]);
    const double root = std::sqrt(
        KeypointLoss(problem, measured, residual.error.squaredNorm(), residual.in_front).weight);
    rows.push_back({root * residual.J_cam, root * residual.J_point, root * residual.error, root,
                    6 * (static_cast<Eigen::Index>(measured.camera) - 1),
                    2 * static_cast<Eigen::Index>(cells[n])});
  }
  return rows;
}

void AddTrack(const std::vector<Row>& rows, Eigen::Matrix3d hessian, CellSums& sums) {
  for (const Row& row : rows) hessian += row.J_point.transpose() * row.J_point;
  const Eigen::Matrix3d inverse = hessian.inverse();
  for (const Row& a : rows) {
    const Eigen::Matrix<double, 2, 3> gain = a.J_point * inverse;
    sums.residual2 += a.error.squaredNorm();
    sums.residual.segment<2>(a.cell) += a.root_weight * a.error;
    for (const Row& b : rows) {
      // Row a, column b of M: what an error of b leaves in the residual of a.
      Eigen::Matrix2d left = -gain * b.J_point.transpose();
      if (&a == &b) {
        left += Eigen::Matrix2d::Identity();
        sums.dof += left.trace();
      }
      const Eigen::Matrix2d cells = a.root_weight * b.root_weight * left;
      sums.kernel.block<2, 2>(a.cell, b.cell) += cells;
      if (a.camera >= 0) {
        sums.coupling.block<6, 2>(a.camera, b.cell).noalias() +=
            b.root_weight * a.J_cam.transpose() * left;
      }
    }
  }
}

CellSums SumCells(const RigAdjustment& problem,
                  const RigAdjustmentState& state,
                  const Cells& cells) {
  CellSums sums;
  const Eigen::Index num_cells = static_cast<Eigen::Index>(cells.cells.size());
  sums.coupling = Eigen::MatrixXd::Zero(problem.NumCameraUnknowns(), 2 * num_cells);
  sums.kernel = Eigen::MatrixXd::Zero(2 * num_cells, 2 * num_cells);
  sums.residual = Eigen::VectorXd::Zero(2 * num_cells);
  for (size_t t = 0; t < problem.NumTracks(); ++t) {
    AddTrack(RowsOf(problem, state, cells.of_observation, t), problem.PointInformation(), sums);
  }
  return sums;
}

}  // namespace

AdjustmentCovariance EstimateCovariance(const RigAdjustment& problem,
                                        const RigAdjustmentState& state) {
  ReducedSystem system;
  Linearize(problem, state, 0.0, system);
  RigAdjustment motions_only = problem;
  motions_only.observations.clear();
  motions_only.begins = {0};
  ReducedSystem motions;
  Linearize(motions_only, state, 0.0, motions);

  const Eigen::Index n = problem.NumCameraUnknowns();
  const Eigen::MatrixXd inverse = system.hessian.ldlt().solve(Eigen::MatrixXd::Identity(n, n));
  const Cells cells = FindCells(problem);
  CellSums sums = SumCells(problem, state, cells);
  // The cameras take their share of M as well.
  const Eigen::MatrixXd influence = inverse * sums.coupling;
  const Eigen::MatrixXd H_keypoints = system.hessian - motions.hessian;
  sums.kernel.noalias() -= sums.coupling.transpose() * influence;
  sums.dof -= (inverse * H_keypoints).trace();
  sums.residual2 /= WeightedVariance(problem.keypoint_loss2);

  // Two equations in the two variances.
  const Eigen::MatrixXd Q = CellCorrelation(cells.cells);
  const Eigen::MatrixXd KQ = sums.kernel * Q;
  const double tr_K = KQ.trace();
  const double tr_K2 = KQ.cwiseProduct(KQ.transpose()).sum();
  const double cells2 =
      sums.residual.dot(Q * sums.residual) / WeightedVariance(problem.keypoint_loss2);
  const double determinant = sums.dof * tr_K2 - tr_K * tr_K;
  double shared2 = 0.0;
  if (determinant > 0.0) {
    shared2 = std::max(0.0, (sums.dof * cells2 - tr_K * sums.residual2) / determinant);
  }
  const double independent2 =
      sums.dof > 0.0 ? std::max(0.25, (sums.residual2 - shared2 * tr_K) / sums.dof) : 1.0;

  AdjustmentCovariance result;
  result.residuals = {std::sqrt(independent2), std::sqrt(shared2)};
  result.cameras = inverse * (motions.hessian + independent2 * H_keypoints) * inverse;
  result.cameras.noalias() += shared2 * influence * Q * influence.transpose();
  return result;
}

}  // namespace covinz
