#include "covinz/rig_sampson.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "sampson_kernels.h"

namespace covinz {
namespace {

SampsonPose PoseOf(const Eigen::Matrix3d& R,
                   const Eigen::Vector3d& baseline,
                   double query_weight,
                   double cand_weight,
                   double max_error_px) {
  SampsonPose pose;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(pose.R) = R;
  Eigen::Map<Eigen::Vector3d>(pose.b) = baseline;
  pose.query_weight = query_weight;
  pose.cand_weight = cand_weight;
  pose.max_error2 = max_error_px * max_error_px;
  pose.max_sine2 = pose.max_error2 * (query_weight + cand_weight);
  return pose;
}

Matrix6d Symmetric(const double upper[21]) {
  Matrix6d matrix;
  for (int row = 0, entry = 0; row < 6; ++row) {
    for (int col = row; col < 6; ++col, ++entry) matrix(row, col) = matrix(col, row) = upper[entry];
  }
  return matrix;
}

}  // namespace

RigSampson::RigSampson(const RigPairs& rigs, InstructionSet instruction_set)
    : instruction_set_(instruction_set) {
  if (!IsSupported(instruction_set))
    throw std::invalid_argument("this processor lacks the instruction set");
  rigs.Check();
  for (size_t p = 0; p < rigs.pairs.size(); ++p) {
    const BearingPairs& matches = rigs.pairs[p];
    const Eigen::Isometry3d& T_query_cam = rigs.T_query_cam[static_cast<size_t>(matches.query_cam)];
    const Eigen::Isometry3d& T_cand_cam = rigs.T_cand_cam[static_cast<size_t>(matches.cand_cam)];
    Pair pair;
    pair.query_centre = T_query_cam.translation();
    pair.cand_centre = T_cand_cam.translation();
    pair.query_weight = 1.0 / (matches.query_focal_px * matches.query_focal_px);
    pair.cand_weight = 1.0 / (matches.cand_focal_px * matches.cand_focal_px);
    pair.num_matches = static_cast<int>(matches.size());
    pair.first_block = rays_.size() / kBlockSize;
    pair.num_blocks = (matches.size() + kLanes - 1) / kLanes;
    rays_.resize(rays_.size() + pair.num_blocks * kBlockSize,
                 std::numeric_limits<double>::quiet_NaN());
    for (size_t i = 0; i < matches.size(); ++i) {
      double* lane = &rays_[(pair.first_block + i / kLanes) * kBlockSize + i % kLanes];
      const Eigen::Vector3d q = T_query_cam.linear() * matches.query[i];
      const Eigen::Vector3d c = T_cand_cam.linear() * matches.cand[i];
      for (int k = 0; k < 3; ++k) {
        lane[static_cast<size_t>(k) * kLanes] = q[k];
        lane[static_cast<size_t>(k + 3) * kLanes] = c[k];
      }
    }
    num_matches_ += pair.num_matches;
    pairs_.push_back(pair);
  }
}

Eigen::Vector3d RigSampson::Baseline(const Pair& pair,
                                     const Eigen::Isometry3d& T_cand_query) const {
  return T_cand_query * pair.query_centre - pair.cand_centre;
}

RigScore RigSampson::ScorePair(size_t pair_index,
                               const Eigen::Matrix3d& R_cand_query,
                               const Eigen::Vector3d& baseline,
                               double max_error_px,
                               int stride) const {
  const Pair& pair = pairs_[pair_index];
  const SampsonPose pose =
      PoseOf(R_cand_query, baseline, pair.query_weight, pair.cand_weight, max_error_px);
  const SampsonSums sums =
      ScoreBlocks(instruction_set_, pose, rays_.data() + pair.first_block * kBlockSize,
                  pair.num_blocks, static_cast<size_t>(stride));
  return {sums.gain, static_cast<int>(sums.num_inliers)};
}

RigScore RigSampson::Score(const Eigen::Isometry3d& T_cand_query,
                           double max_error_px,
                           int stride) const {
  RigScore score;
  for (size_t p = 0; p < pairs_.size(); ++p) {
    const RigScore of_pair = ScorePair(p, T_cand_query.linear(), Baseline(pairs_[p], T_cand_query),
                                       max_error_px, stride);
    score.gain += of_pair.gain;
    score.num_inliers += of_pair.num_inliers;
  }
  return score;
}

std::vector<std::vector<int>> RigSampson::Inliers(const Eigen::Isometry3d& T_cand_query,
                                                  double max_error_px) const {
  std::vector<std::vector<int>> inliers(pairs_.size());
  std::vector<int64_t> marks;
  for (size_t p = 0; p < pairs_.size(); ++p) {
    const Pair& pair = pairs_[p];
    marks.resize(pair.num_blocks * kLanes);
    MarkInliers(instruction_set_,
                PoseOf(T_cand_query.linear(), Baseline(pair, T_cand_query), pair.query_weight,
                       pair.cand_weight, max_error_px),
                rays_.data() + pair.first_block * kBlockSize, pair.num_blocks, marks.data());
    for (int i = 0; i < pair.num_matches; ++i) {
      if (marks[static_cast<size_t>(i)] != 0) inliers[p].push_back(i);
    }
  }
  return inliers;
}

SampsonSystem RigSampson::Linearize(const Eigen::Isometry3d& T_cand_query,
                                    double max_error_px,
                                    int stride) const {
  SampsonSystem system;
  int num_matches = 0;
  const Eigen::Matrix3d R = T_cand_query.linear();
  for (const Pair& pair : pairs_) {
    const Eigen::Vector3d b = Baseline(pair, T_cand_query);
    const SampsonNormalSums sums = LinearizeBlocks(
        instruction_set_, PoseOf(R, b, pair.query_weight, pair.cand_weight, max_error_px),
        rays_.data() + pair.first_block * kBlockSize, pair.num_blocks, static_cast<size_t>(stride));
    for (size_t i = 0; i < pair.num_blocks; i += static_cast<size_t>(stride)) {
      num_matches +=
          std::min(static_cast<int>(kLanes), pair.num_matches - static_cast<int>(i * kLanes));
    }
    // Right perturbation (theta, rho) of T_cand_query: the kernel's rotation is R theta, and b
    // moves by R theta x R p_q + R rho.
    Matrix6d chain = Matrix6d::Zero();
    chain.topLeftCorner<3, 3>() = R;
    chain.bottomLeftCorner<3, 3>() = -R * Hat(pair.query_centre);
    chain.bottomRightCorner<3, 3>() = R;
    system.JtJ += chain.transpose() * Symmetric(sums.JtJ) * chain;
    system.Jte += chain.transpose() * Eigen::Map<const Vector6d>(sums.Jte);
    system.cost += sums.cost;
    system.num_inliers += static_cast<int>(sums.num_inliers);
  }
  system.cost += (num_matches - system.num_inliers) * max_error_px * max_error_px / 3.0;
  return system;
}

}  // namespace covinz
