#include "covinz/rig_sampson.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "sampson_kernels.h"

namespace covinz {
namespace {

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
    rays_.resize(rays_.size() + pair.num_blocks * kBlockSize, 0.0f);
    for (size_t i = 0; i < matches.size(); ++i) {
      float* lane =
          &rays_[(pair.first_block + i % pair.num_blocks) * kBlockSize + i / pair.num_blocks];
      const Eigen::Vector3d q = T_query_cam.linear() * matches.query[i];
      const Eigen::Vector3d c = T_cand_cam.linear() * matches.cand[i];
      for (int k = 0; k < 3; ++k) {
        lane[static_cast<size_t>(k) * kLanes] = static_cast<float>(q[k]);
        lane[static_cast<size_t>(k + 3) * kLanes] = static_cast<float>(c[k]);
      }
    }
    num_matches_ += pair.num_matches;
    pairs_.push_back(pair);
  }
}

SampsonTask RigSampson::TaskOf(size_t pair_index,
                               const Eigen::Matrix3d& R_cand_query,
                               const Eigen::Vector3d& translation,
                               double max_error_px) const {
  const Pair& pair = pairs_[pair_index];
  SampsonTask task;
  const Eigen::Vector3d lever = R_cand_query * pair.query_centre;
  Eigen::Map<Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>(task.R) = R_cand_query.cast<float>();
  Eigen::Map<Eigen::Vector3f>(task.lever) = lever.cast<float>();
  Eigen::Map<Eigen::Vector3f>(task.b) = (lever + translation - pair.cand_centre).cast<float>();
  task.query_weight = static_cast<float>(pair.query_weight);
  task.cand_weight = static_cast<float>(pair.cand_weight);
  task.max_error2 = static_cast<float>(max_error_px * max_error_px);
  task.max_sine2 = task.max_error2 * (task.query_weight + task.cand_weight);
  task.blocks = rays_.data() + pair.first_block * kBlockSize;
  task.num_blocks = pair.num_blocks;
  return task;
}

std::vector<SampsonTask> RigSampson::Tasks(const Eigen::Isometry3d& T_cand_query,
                                           double max_error_px) const {
  std::vector<SampsonTask> tasks;
  tasks.reserve(pairs_.size());
  for (size_t p = 0; p < pairs_.size(); ++p) {
    tasks.push_back(TaskOf(p, T_cand_query.linear(), T_cand_query.translation(), max_error_px));
  }
  return tasks;
}

RigScore RigSampson::ScorePair(size_t pair,
                               const Eigen::Matrix3d& R_cand_query,
                               const Eigen::Vector3d& baseline,
                               double max_error_px,
                               int stride) const {
  SampsonTask task = TaskOf(pair, R_cand_query, Eigen::Vector3d::Zero(), max_error_px);
  Eigen::Map<Eigen::Vector3f>(task.b) = baseline.cast<float>();
  const SampsonSums sums = ScoreBlocks(instruction_set_, &task, 1, static_cast<size_t>(stride));
  return {sums.gain, static_cast<int>(sums.num_inliers)};
}

RigScore RigSampson::Score(const Eigen::Isometry3d& T_cand_query,
                           double max_error_px,
                           int stride) const {
  const std::vector<SampsonTask> tasks = Tasks(T_cand_query, max_error_px);
  const SampsonSums sums =
      ScoreBlocks(instruction_set_, tasks.data(), tasks.size(), static_cast<size_t>(stride));
  return {sums.gain, static_cast<int>(sums.num_inliers)};
}

std::vector<std::vector<int>> RigSampson::Inliers(const Eigen::Isometry3d& T_cand_query,
                                                  double max_error_px) const {
  std::vector<std::vector<int>> inliers(pairs_.size());
  std::vector<int32_t> marks;
  const std::vector<SampsonTask> tasks = Tasks(T_cand_query, max_error_px);
  for (size_t p = 0; p < pairs_.size(); ++p) {
    const Pair& pair = pairs_[p];
    marks.resize(pair.num_blocks * kLanes);
    MarkInliers(instruction_set_, tasks[p], marks.data());
    for (int i = 0; i < pair.num_matches; ++i) {
      const size_t n = static_cast<size_t>(i);
      if (marks[n % pair.num_blocks * kLanes + n / pair.num_blocks] != 0) inliers[p].push_back(i);
    }
  }
  return inliers;
}

size_t RigSampson::NumSampled(int stride) const {
  size_t num_matches = 0;
  for (const Pair& pair : pairs_) {
    for (size_t i = 0; i < pair.num_blocks; i += static_cast<size_t>(stride)) {
      // Lanes that are filled: matches i, i + num_blocks, i + 2 num_blocks ...
      const size_t rest = static_cast<size_t>(pair.num_matches) + pair.num_blocks - 1 - i;
      num_matches += rest / pair.num_blocks;
    }
  }
  return num_matches;
}

SampsonSystem RigSampson::Linearize(const Eigen::Isometry3d& T_cand_query,
                                    double max_error_px,
                                    int stride) const {
  if (pairs_.empty()) return {};
  const std::vector<SampsonTask> tasks = Tasks(T_cand_query, max_error_px);
  const SampsonNormalSums sums =
      LinearizeBlocks(instruction_set_, tasks.data(), tasks.size(), static_cast<size_t>(stride));
  // The kernels' perturbation is the left one, R times the right one.
  Matrix6d turn = Matrix6d::Zero();
  turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = T_cand_query.linear();
  SampsonSystem system;
  system.JtJ = turn.transpose() * Symmetric(sums.JtJ) * turn;
  system.Jte = turn.transpose() * Eigen::Map<const Vector6d>(sums.Jte);
  system.num_inliers = static_cast<int>(sums.num_inliers);
  const double num_outliers = static_cast<double>(NumSampled(stride)) - sums.num_inliers;
  system.cost = sums.cost + num_outliers * max_error_px * max_error_px / 3.0;
  return system;
}

}  // namespace covinz
