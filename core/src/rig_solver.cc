#include "rig_solver.h"

#include <algorithm>
#include <numeric>

#include <opengv/relative_pose/methods.hpp>

namespace covinz {

SeventeenPointSolver::SeventeenPointSolver(const RigPairs& rigs,
                                           const std::vector<std::vector<int>>& subset)
    : T_cand_cam0_(Eigen::Isometry3d::Identity()),
      T_cam0_query_(Eigen::Isometry3d::Identity()),
      adapter_(cand_, query_, cand_cams_, query_cams_, offsets_, rotations_) {
  for (const std::vector<Eigen::Isometry3d>* cams : {&rigs.T_cand_cam, &rigs.T_query_cam}) {
    for (const Eigen::Isometry3d& T_rig_cam : *cams) {
      const Eigen::Isometry3d T_cam0_cam = cams->front().inverse() * T_rig_cam;
      offsets_.push_back(T_cam0_cam.translation());
      rotations_.push_back(T_cam0_cam.linear());
    }
  }
  if (!rigs.T_cand_cam.empty()) T_cand_cam0_ = rigs.T_cand_cam.front();
  if (!rigs.T_query_cam.empty()) T_cam0_query_ = rigs.T_query_cam.front().inverse();
  const int num_cand_cams = static_cast<int>(rigs.T_cand_cam.size());
  first_row_.push_back(0);
  for (size_t p = 0; p < rigs.pairs.size(); ++p) {
    const BearingPairs& pairs = rigs.pairs[p];
    for (const int i : subset[p]) {
      cand_.push_back(pairs.cand[static_cast<size_t>(i)]);
      query_.push_back(pairs.query[static_cast<size_t>(i)]);
      cand_cams_.push_back(pairs.cand_cam);
      query_cams_.push_back(num_cand_cams + pairs.query_cam);
    }
    first_row_.push_back(NumMatches());
  }
}

std::vector<int> SeventeenPointSolver::DrawSample(Random& random) const {
  const int num_pairs = static_cast<int>(first_row_.size()) - 1;
  std::vector<int> order;
  if (num_pairs > kSampleSize) {
    random.DrawDistinct(0, num_pairs, kSampleSize, order);
  } else {
    order.resize(static_cast<size_t>(num_pairs));
    std::iota(order.begin(), order.end(), 0);
  }
  const int share = kSampleSize / static_cast<int>(order.size());
  std::vector<int> sample;
  sample.reserve(kSampleSize);
  for (const int p : order) {
    const int begin = first_row_[static_cast<size_t>(p)];
    const int end = first_row_[static_cast<size_t>(p) + 1];
    // Distinct within the pair: rows of other pairs cannot fall into [begin, end).
    random.DrawDistinct(begin, end, std::min(share, end - begin), sample);
  }
  random.DrawDistinct(0, NumMatches(), kSampleSize - static_cast<int>(sample.size()), sample);
  return sample;
}

std::optional<Eigen::Isometry3d> SeventeenPointSolver::Solve(const std::vector<int>& sample) const {
  Eigen::Isometry3d T_cand0_query0 = Eigen::Isometry3d::Identity();
  T_cand0_query0.matrix().topRows<3>() = opengv::relative_pose::seventeenpt(adapter_, sample);
  if (!T_cand0_query0.matrix().allFinite()) return std::nullopt;
  return T_cand_cam0_ * T_cand0_query0 * T_cam0_query_;
}

}  // namespace covinz
