// Variance components of keypoint errors and the covariance that follows from them.
#include "covinz/rig_covariance.h"

#include <algorithm>
#include <array>
#include <climits>
#include <cmath>
#include <stdexcept>
#include <tuple>
#include <vector>

#include <Eigen/Cholesky>

#include "rig_adjustment.h"

namespace covinz {
namespace {

// E[w s] / E[s] of a normal error in two dimensions, s its square and w the weight of Cauchy's
// loss: with x = loss^2 / 2 this is x (1 - x exp(x) E1(x)). Weighted residuals are that much too
// small.
double WeightedVariance(double loss2) {
  const double x = 0.5 * loss2;
  // 1 / (exp(x) E1(x)) by its continued fraction, Abramowitz and Stegun 5.1.22.
  double fraction = x;
  for (int k = 60; k > 0; --k) fraction = x + k / (1.0 + k / fraction);
  return x * (1.0 - x / fraction);
}

struct Cell {
  int camera;
  int across;  // position in the image as two angles
  int down;

  bool operator<(const Cell& o) const {
    return std::tie(camera, across, down) < std::tie(o.camera, o.across, o.down);
  }
  bool operator==(const Cell& o) const { return !(*this < o) && !(o < *this); }
};

Cell CellOf(const BearingMeasurement& measured, double cell_rad) {
  const Eigen::Vector3d& z = measured.bearing;
  const double across = std::atan2(z.x(), z.z());
  const double down = std::atan2(z.y(), std::hypot(z.x(), z.z()));
  return {measured.camera, static_cast<int>(std::floor(across / cell_rad)),
          static_cast<int>(std::floor(down / cell_rad))};
}

// The cells that have keypoints, by camera. The errors of the cells of one camera, x of all and
// then y of all, make a block, so that Q is block-diagonal.
class Cells {
 public:
  Cells(const RigAdjustment& problem, const RefinementCovarianceOptions& options) {
    std::vector<Cell> of_observation;
    for (const BearingMeasurement& measured : problem.observations) {
      of_observation.push_back(CellOf(measured, options.cell_rad));
    }
    cells_ = of_observation;
    std::sort(cells_.begin(), cells_.end());
    cells_.erase(std::unique(cells_.begin(), cells_.end()), cells_.end());
    for (int c = 0; c <= problem.num_cameras; ++c) {
      begins_.push_back(std::lower_bound(cells_.begin(), cells_.end(), Cell{c, INT_MIN, INT_MIN}) -
                        cells_.begin());
    }
    for (const Cell& cell : of_observation) {
      const Eigen::Index n = std::lower_bound(cells_.begin(), cells_.end(), cell) - cells_.begin();
      const Eigen::Index begin = begins_[static_cast<size_t>(cell.camera)];
      x_errors_.push_back(begin + n);
      y_errors_.push_back(n + begins_[static_cast<size_t>(cell.camera) + 1]);
    }
    for (size_t c = 0; c + 1 < begins_.size(); ++c) {
      correlations_.push_back(Correlation(begins_[c], begins_[c + 1] - begins_[c], options));
    }
  }

  Eigen::Index NumErrors() const { return 2 * static_cast<Eigen::Index>(cells_.size()); }

  // Positions of the errors of the cell of an observation.
  Eigen::Index XError(size_t observation) const { return x_errors_[observation]; }
  Eigen::Index YError(size_t observation) const { return y_errors_[observation]; }

  // A Q.
  template <typename Matrix>
  Matrix TimesCorrelation(const Matrix& A) const {
    Matrix product(A.rows(), A.cols());
    for (size_t c = 0; c + 1 < begins_.size(); ++c) {
      const Eigen::Index n = begins_[c + 1] - begins_[c];
      const Matrix Q = correlations_[c].template cast<typename Matrix::Scalar>();
      for (const Eigen::Index first : {2 * begins_[c], 2 * begins_[c] + n}) {
        product.middleCols(first, n).noalias() = A.middleCols(first, n) * Q;
      }
    }
    return product;
  }

 private:
  // Between n cells of one camera, from the given one on.
  Eigen::MatrixXd Correlation(Eigen::Index begin,
                              Eigen::Index n,
                              const RefinementCovarianceOptions& options) const {
    const double longest_rad = std::ldexp(options.min_length_rad, options.num_octaves - 1);
    Eigen::MatrixXd Q(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = 0; j <= i; ++j) {
        const Cell& a = cells_[static_cast<size_t>(begin + i)];
        const Cell& b = cells_[static_cast<size_t>(begin + j)];
        const double across = options.cell_rad * (a.across - b.across);
        const double down = options.cell_rad * (a.down - b.down);
        // Of the longest octave; half the length is four times the exponent.
        double correlation =
            std::exp(-0.5 * (across * across + down * down) / (longest_rad * longest_rad));
        double sum = 0.0;
        for (int octave = 0; octave < options.num_octaves; ++octave) {
          sum += correlation;
          correlation *= correlation;
          correlation *= correlation;
        }
        Q(i, j) = Q(j, i) = sum / options.num_octaves;
      }
    }
    return Q;
  }

  std::vector<Cell> cells_;
  std::vector<Eigen::Index> begins_;  // first cell of each camera, and one past the last
  std::vector<Eigen::Index> x_errors_;
  std::vector<Eigen::Index> y_errors_;
  std::vector<Eigen::MatrixXd> correlations_;  // between the cells of each camera
};

// An observation of the track at hand, all by the root of its weight.
struct Row {
  Eigen::Matrix<double, 2, 6> J_cam;
  Eigen::Matrix<double, 2, 3> J_point;
  Eigen::Vector2d error;
  Eigen::Vector2d shift;  // what the time from the middle row to the keypoint's does
  double root_weight;
  Eigen::Index camera;  // its first unknown, negative for camera 0
  Eigen::Index rig;     // 0 of the candidate, 1 of the query
  Eigen::Index x;       // its cell's errors
  Eigen::Index y;
};

// The cameras' exposures as RigAdjustment numbers them, with focal lengths [px].
struct Shutter {
  // A camera's motion for a unit of the bearing's slope down, above the middle row and below it.
  std::vector<std::array<Vector6d, 2>> motion_per_unit;
  int num_cand = 0;

  bool empty() const { return motion_per_unit.empty(); }
};

Shutter ShutterOf(const RefinedRig& cand, const RefinedRig& query) {
  Shutter shutter;
  shutter.num_cand = static_cast<int>(cand.T_rig_cam.size());
  if (cand.exposures.empty() && query.exposures.empty()) return shutter;
  for (const RefinedRig* rig : {&cand, &query}) {
    for (size_t c = 0; c < rig->T_rig_cam.size(); ++c) {
      const CameraExposure exposure = rig->exposures.empty() ? CameraExposure{} : rig->exposures[c];
      const double unit_s = rig->focal_px[c] * exposure.row_s;
      shutter.motion_per_unit.push_back(
          {unit_s * exposure.twist_before, unit_s * exposure.twist_after});
    }
  }
  return shutter;
}

// Rows are those of a pinhole; where the lens bends them the shift is that much off.
Eigen::Vector2d ShiftOf(const Shutter& shutter,
                        const BearingMeasurement& measured,
                        const Eigen::Matrix<double, 2, 6>& J_cam) {
  if (shutter.empty()) return Eigen::Vector2d::Zero();
  const double slope = measured.bearing.y() / std::max(measured.bearing.z(), 0.1);
  const size_t c = static_cast<size_t>(measured.camera);
  return slope * (J_cam * shutter.motion_per_unit[c][slope < 0.0 ? 0 : 1]);
}

void FillRows(const RigAdjustment& problem,
              const RigAdjustmentState& state,
              const Cells& cells,
              const Shutter& shutter,
              size_t track,
              std::vector<Row>& rows) {
  const InverseDistancePoint& point = state.points[track];
  const Eigen::Matrix<double, 2, 3> basis = TangentBasis(point.direction);
  rows.clear();
  for (int i = problem.begins[track]; i < problem.begins[track + 1]; ++i) {
    const size_t n = static_cast<size_t>(i);
    const BearingMeasurement& measured = problem.observations[n];
    const BearingResidual residual = EvaluateBearing(
        measured, point, basis, state.T_world_cam[static_cast<size_t>(measured.camera)]);
    const double root = std::sqrt(KeypointWeight(problem, residual));
    rows.push_back({root * residual.J_cam, root * residual.J_point, root * residual.error,
                    root * ShiftOf(shutter, measured, residual.J_cam), root,
                    6 * (static_cast<Eigen::Index>(measured.camera) - 1),
                    measured.camera < shutter.num_cand ? 0 : 1, cells.XError(n), cells.YError(n)});
  }
}

// What the variance components are made of; first with M as the points leave it.
struct CellSums {
  Eigen::MatrixXd coupling;  // A: camera unknowns x cell errors
  Eigen::MatrixXf kernel;    // K; single precision is far more than a variance of it needs
  Eigen::VectorXd residual;  // C^T e
  // G: what the shutters of the candidate's and of the query's cameras do to the gradient.
  Eigen::Matrix<double, Eigen::Dynamic, 2> shutter;
  double residual2 = 0.0;  // e^T e
  double dof = 0.0;        // tr(M)
};

void AddTrack(const std::vector<Row>& rows, Eigen::Matrix3d information, CellSums& sums) {
  for (const Row& row : rows) information.noalias() += row.J_point.transpose() * row.J_point;
  const Eigen::Matrix3d inverse = information.inverse();
  for (const Row& a : rows) {
    const Eigen::Matrix<double, 2, 3> gain = a.J_point * inverse;
    sums.residual2 += a.error.squaredNorm();
    sums.residual(a.x) += a.root_weight * a.error.x();
    sums.residual(a.y) += a.root_weight * a.error.y();
    for (const Row& b : rows) {
      // Row a, column b of M: what an error of b leaves in the residual of a.
      Eigen::Matrix2d left = -gain * b.J_point.transpose();
      if (&a == &b) {
        left += Eigen::Matrix2d::Identity();
        sums.dof += left.trace();
      }
      if (a.camera >= 0) {
        sums.shutter.block<6, 1>(a.camera, b.rig) += a.J_cam.transpose() * (left * b.shift);
      }
      left *= b.root_weight;
      if (a.camera >= 0) {
        const Eigen::Matrix<double, 6, 2> coupling = a.J_cam.transpose() * left;
        sums.coupling.block<6, 1>(a.camera, b.x) += coupling.col(0);
        sums.coupling.block<6, 1>(a.camera, b.y) += coupling.col(1);
      }
      sums.kernel(a.x, b.x) += static_cast<float>(a.root_weight * left(0, 0));
      sums.kernel(a.y, b.x) += static_cast<float>(a.root_weight * left(1, 0));
      sums.kernel(a.x, b.y) += static_cast<float>(a.root_weight * left(0, 1));
      sums.kernel(a.y, b.y) += static_cast<float>(a.root_weight * left(1, 1));
    }
  }
}

CellSums SumCells(const RigAdjustment& problem,
                  const RigAdjustmentState& state,
                  const Cells& cells,
                  const Shutter& shutter) {
  CellSums sums;
  sums.shutter.setZero(problem.NumCameraUnknowns(), 2);
  sums.coupling = Eigen::MatrixXd::Zero(problem.NumCameraUnknowns(), cells.NumErrors());
  sums.kernel = Eigen::MatrixXf::Zero(cells.NumErrors(), cells.NumErrors());
  sums.residual = Eigen::VectorXd::Zero(cells.NumErrors());
  std::vector<Row> rows;
  for (size_t t = 0; t < problem.NumTracks(); ++t) {
    FillRows(problem, state, cells, shutter, t, rows);
    AddTrack(rows, problem.PointInformation(), sums);
  }
  return sums;
}

// i^2 and s^2.
struct VarianceComponents {
  double independent;
  double shared;
};

VarianceComponents EstimateComponents(const CellSums& sums,
                                      const Cells& cells,
                                      double weighted_variance,
                                      double min_independent) {
  const Eigen::MatrixXf KQ = cells.TimesCorrelation(sums.kernel);
  const double tr_KQ = KQ.trace();
  const double tr_KQKQ = KQ.cwiseProduct(KQ.transpose()).sum();
  const Eigen::MatrixXd sums_Q = cells.TimesCorrelation<Eigen::MatrixXd>(sums.residual.transpose());
  const double square = sums.residual2 / weighted_variance;
  const double cells_square = (sums_Q * sums.residual)(0) / weighted_variance;
  const double determinant = sums.dof * tr_KQKQ - tr_KQ * tr_KQ;
  VarianceComponents result{min_independent, 0.0};
  if (!(sums.dof > 0.0 && determinant > 0.0)) return result;
  result.shared = std::max(0.0, (sums.dof * cells_square - tr_KQ * square) / determinant);
  result.independent = std::max(min_independent, (square - result.shared * tr_KQ) / sums.dof);
  return result;
}

// What is known before the images: the motions and, so that nothing is singular, the pose of the
// query's first camera (first unknown q) to 100 m.
Eigen::MatrixXd PriorHessian(RigAdjustment problem,
                             const RigAdjustmentState& state,
                             Eigen::Index q) {
  problem.blocks = {};
  ReducedSystem system;
  Linearize(problem, state, 0.0, system);
  system.hessian.diagonal().segment<6>(q).array() += 1e-4;
  return system.hessian;
}

}  // namespace

void RefinementCovarianceOptions::Check() const {
  if (!(cell_rad > 0.0 && min_length_rad > 0.0 && min_independent_px > 0.0)) {
    throw std::invalid_argument("RefinementCovarianceOptions: lengths and errors must be positive");
  }
  if (num_octaves < 1) {
    throw std::invalid_argument("RefinementCovarianceOptions.num_octaves must be at least 1");
  }
}

RefinementCovariance EstimateRefinementCovariance(const RefinedRig& cand,
                                                  const RefinedRig& query,
                                                  const RigTracks& tracks,
                                                  const RigRefinement& refinement,
                                                  const RigRefinementOptions& refinement_options,
                                                  const RefinementCovarianceOptions& options) {
  refinement_options.Check();
  options.Check();
  cand.Check();
  query.Check();
  RigAdjustment problem = MakeAdjustment(cand, query, tracks, refinement_options);
  problem.blocks = BlockTracks(problem);
  const RigAdjustmentState state{
      CamerasInWorld(refinement.T_cand_cam, refinement.T_query_cam, refinement.T_cand_query),
      refinement.points};
  ReducedSystem system;
  Linearize(problem, state, 0.0, system);
  // The query's first camera, whose covariance is wanted.
  const Eigen::Index q = 6 * (static_cast<Eigen::Index>(cand.T_rig_cam.size()) - 1);
  const Eigen::Index n = problem.NumCameraUnknowns();
  const Eigen::MatrixXd H_prior = PriorHessian(problem, state, q);
  system.hessian.diagonal().segment<6>(q).array() += 1e-4;
  const Eigen::MatrixXd H_keypoints = system.hessian - H_prior;
  const Eigen::MatrixXd inverse = system.hessian.ldlt().solve(Eigen::MatrixXd::Identity(n, n));

  const Cells cells(problem, options);
  CellSums sums = SumCells(problem, state, cells, ShutterOf(cand, query));
  // The cameras take their share of the errors as well.
  const Eigen::MatrixXd influence = inverse * sums.coupling;
  sums.kernel.noalias() -= sums.coupling.cast<float>().transpose() * influence.cast<float>();
  sums.dof -= inverse.cwiseProduct(H_keypoints).sum();
  const double min_sigma = options.min_independent_px / refinement_options.sigma_px;
  const VarianceComponents variance = EstimateComponents(
      sums, cells, WeightedVariance(problem.keypoint_loss2), min_sigma * min_sigma);

  const auto rows = inverse.middleRows<6>(q);
  const Eigen::MatrixXd cells_rows = influence.middleRows<6>(q);
  // H^-1 (H_motions + i^2 H_keypoints) H^-1 as a sum of two positive terms, whatever i^2: rounding
  // must not make it indefinite.
  const Matrix6d whole = inverse.block<6, 6>(q, q);
  const double excess = variance.independent - 1.0;
  const Eigen::Matrix<double, 6, 2> shutter = rows * sums.shutter;
  const Matrix6d camera =
      (excess < 0.0
           ? Matrix6d(variance.independent * whole - excess * (rows * H_prior * rows.transpose()))
           : Matrix6d(whole + excess * (rows * H_keypoints * rows.transpose()))) +
      variance.shared * cells.TimesCorrelation(cells_rows) * cells_rows.transpose() +
      shutter * shutter.transpose();
  const Matrix6d Ad = AdjointSE3(query.T_rig_cam[0]);
  const auto to_body = [&Ad](const Matrix6d& of_camera) {
    const Matrix6d moved = Ad * of_camera * Ad.transpose();
    return Matrix6d(0.5 * (moved + moved.transpose()));
  };
  return {to_body(camera), std::sqrt(variance.independent) * refinement_options.sigma_px,
          std::sqrt(variance.shared) * refinement_options.sigma_px, to_body(whole)};
}

}  // namespace covinz
