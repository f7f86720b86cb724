// Truncated Sampson losses of solutions and the significance of their difference.
#include "covinz/rig_selection.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <utility>

#include "rig_adjustment.h"

namespace covinz {
namespace {

// Sums of the difference of two solutions' log-likelihoods.
class Witnesses {
 public:
  explicit Witnesses(double cell_rad) : cell_rad_(cell_rad) {}

  void Add(const Eigen::Vector3d& ray_query, double difference) {
    const double across = std::atan2(ray_query.y(), ray_query.x());
    const double up = std::atan2(ray_query.z(), std::hypot(ray_query.x(), ray_query.y()));
    cells_[{static_cast<int>(std::floor(across / cell_rad_)),
            static_cast<int>(std::floor(up / cell_rad_))}] += difference;
    sum_ += difference;
  }

  double sum() const { return sum_; }

  // Of the sum: what the votes against the majority show of the noise, as many again of which are
  // among those for it; and no cell decides alone.
  double Variance() const {
    double against = 0.0;
    double largest = 0.0;
    for (const auto& [cell, difference] : cells_) {
      if (difference * sum_ < 0.0) against += difference * difference;
      largest = std::max(largest, difference * difference);
    }
    return 2.0 * against + largest;
  }

 private:
  double cell_rad_;
  std::map<std::pair<int, int>, double> cells_;
  double sum_ = 0.0;
};

bool FurtherApart(const Eigen::Isometry3d& T_a,
                  const Eigen::Isometry3d& T_b,
                  double rotation_rad,
                  double distance_m) {
  const Vector6d difference = LogSE3(T_a.inverse() * T_b);
  return difference.head<3>().norm() > rotation_rad || difference.tail<3>().norm() > distance_m;
}

}  // namespace

void RigSelectionOptions::Check() const {
  if (!(sigma_px > 0.0 && max_error_sigmas > 0.0 && cell_rad > 0.0)) {
    throw std::invalid_argument("RigSelectionOptions: errors and cells must be positive");
  }
  if (!(min_distinct_m >= 0.0 && min_distinct_rad >= 0.0 && min_significance > 0.0 &&
        min_log_likelihood_ratio >= 0.0 && max_valley_sigmas > 0.0)) {
    throw std::invalid_argument("RigSelectionOptions: limits must not be negative");
  }
}

SolutionScore ScoreSolution(const RigPairs& rigs,
                            const RigRefinement& solution,
                            const RigRefinementOptions& refinement_options,
                            const RigSelectionOptions& options) {
  const double max_error_px = options.max_error_sigmas * options.sigma_px;
  const double worst = options.max_error_sigmas * options.max_error_sigmas;
  SolutionScore score;
  score.losses.reserve(rigs.NumMatches());
  score.motion_cost = 0.0;
  score.num_inliers = 0;
  for (const Vector6d& residual : solution.motion_residuals) {
    score.motion_cost += MotionLoss(residual.squaredNorm(), refinement_options).cost;
  }
  score.cost = score.motion_cost;
  for (const BearingPairs& pairs : rigs.pairs) {
    const Eigen::Isometry3d T =
        solution.T_cand_cam.at(static_cast<size_t>(pairs.cand_cam)).inverse() *
        solution.T_cand_query * solution.T_query_cam.at(static_cast<size_t>(pairs.query_cam));
    const Eigen::Matrix3d E = EssentialMatrix(T);
    std::vector<int> inliers;
    for (size_t i = 0; i < pairs.size(); ++i) {
      const double error2 = SquaredSampsonError_px2(E, pairs, i);
      const bool inlier =
          error2 <= max_error_px * max_error_px && InFrontOfBoth(T, pairs, i, max_error_px);
      if (inlier) inliers.push_back(static_cast<int>(i));
      score.losses.push_back(inlier ? error2 / (options.sigma_px * options.sigma_px) : worst);
      score.cost += score.losses.back();
    }
    score.num_inliers += static_cast<int>(inliers.size());
    score.inliers.push_back(std::move(inliers));
  }
  return score;
}

bool AreEqual(const Eigen::Isometry3d& T_a,
              const Eigen::Isometry3d& T_b,
              const RigSelectionOptions& options) {
  return !FurtherApart(T_a, T_b, 0.1 * options.min_distinct_rad, 0.1 * options.min_distinct_m);
}

bool AreDistinct(const Eigen::Isometry3d& T_a,
                 const Eigen::Isometry3d& T_b,
                 const RigSelectionOptions& options) {
  return FurtherApart(T_a, T_b, options.min_distinct_rad, options.min_distinct_m);
}

double Significance(const RigPairs& rigs,
                    const SolutionScore& best,
                    const SolutionScore& other,
                    const RigSelectionOptions& options) {
  Witnesses witnesses(options.cell_rad);
  size_t match = 0;
  for (const BearingPairs& pairs : rigs.pairs) {
    const Eigen::Matrix3d R = rigs.T_query_cam.at(static_cast<size_t>(pairs.query_cam)).linear();
    for (size_t i = 0; i < pairs.size(); ++i, ++match) {
      const double difference = 0.5 * (other.losses.at(match) - best.losses.at(match));
      // Outliers of both have no say.
      if (difference != 0.0) witnesses.Add(R * pairs.query[i], difference);
    }
  }
  const double ratio = witnesses.sum() + 0.5 * (other.motion_cost - best.motion_cost);
  const double least_sigma = options.min_log_likelihood_ratio / options.min_significance;
  return ratio / std::sqrt(witnesses.Variance() + least_sigma * least_sigma);
}

}  // namespace covinz
