#include "hypothesis_pool.h"

#include <algorithm>

#include <Eigen/Eigenvalues>

#include "covinz/sampson_minimization.h"

namespace covinz {
namespace {

// Proposals from noisy minimal samples of an equally good pose differ in their gain by about this
// factor; worse ones are left out.
constexpr double kMinRelativeGain = 0.4;
// A hypothesis that is better explained by the other's is no second solution.
constexpr double kMinRelativeOptimum = 0.5;
// Rough proposals differ less in their gain: all of them have the same error on top.
constexpr double kMinRelativeRough = 0.6;
// Local optimisation from wide to narrow, in units of max_error_px. The last is wider than one: the
// biweight leaves matches at its limit without weight.
constexpr double kWidths[] = {4.0, 2.0, 1.5};
constexpr int kIterationsPerWidth = 3;
constexpr int kFinalIterations = 8;
// About as many matches are enough to get near an optimum, and to tell which pose is better.
constexpr int kNumApproachMatches = 300;
// An optimisation that comes this near to an earlier optimum would end there; in units of the
// distance within which hypotheses are the same.
constexpr double kNear = 0.5;
// Where the best optimum is left, in units of that distance.
constexpr int kMaxRounds = 3;
constexpr double kLeaps[] = {-6.0, -3.0, 3.0, 6.0};

int NumIntersecting(const std::vector<int>& a, const std::vector<int>& b) {
  int count = 0;
  for (auto i = a.begin(), j = b.begin(); i != a.end() && j != b.end();) {
    if (*i == *j) ++count;
    if (*i < *j) {
      ++i;
    } else {
      // *i == *j moves j alone here and i in the next round.
      ++j;
    }
  }
  return count;
}

// Perturbation with a translation of 1 m in the direction that the matches determine least, and the
// rotation that makes up for it best.
Vector6d LeastDetermined(const Matrix6d& information) {
  const Eigen::Matrix3d rotation = information.topLeftCorner<3, 3>();
  const Eigen::Matrix3d coupling = information.topRightCorner<3, 3>();
  const Eigen::Matrix3d turn = -rotation.ldlt().solve(coupling);  // per metre
  const Eigen::Matrix3d marginal =
      information.bottomRightCorner<3, 3>() + coupling.transpose() * turn;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(marginal);
  Vector6d direction;
  direction << turn * eigen.eigenvectors().col(0), eigen.eigenvectors().col(0);
  return direction;
}

}  // namespace

bool HypothesisPool::Propose(const Eigen::Isometry3d& T_cand_query) {
  const double gain = sampson_.Score(T_cand_query, options_.max_error_px).gain;
  if (gain <= kMinRelativeGain * best_proposal_) return false;
  if (gain <= best_proposal_) {
    proposals_.push_back({T_cand_query, gain});
    return false;
  }
  best_proposal_ = gain;
  const size_t previous = best_optimum_;
  Optimize(T_cand_query);
  return best_optimum_ != previous || optima_.size() == 1;
}

bool HypothesisPool::ProposeRough(const Eigen::Isometry3d& T_cand_query, double width_px) {
  const double gain = sampson_.Score(T_cand_query, width_px).gain;
  if (gain <= kMinRelativeRough * best_rough_) return false;
  best_rough_ = std::max(best_rough_, gain);
  return Propose(MinimizeSampson(sampson_, T_cand_query, width_px, kIterationsPerWidth, Stride()));
}

int HypothesisPool::Stride() const {
  return std::max(1, sampson_.NumMatches() / kNumApproachMatches);
}

std::vector<std::vector<int>> HypothesisPool::BestInliers() const {
  return sampson_.Inliers(optima_.at(best_optimum_).T_cand_query, options_.max_error_px);
}

bool HypothesisPool::IsOptimum(const Eigen::Isometry3d& T_cand_query) const {
  return std::any_of(optima_.begin(), optima_.end(), [&](const Pose& optimum) {
    const Vector6d xi = LogSE3(optimum.T_cand_query.inverse() * T_cand_query);
    return xi.head<3>().norm() <= kNear * options_.max_same_angle_rad &&
           xi.tail<3>().norm() <= kNear * options_.max_same_distance_m;
  });
}

// Whether it led to a new optimum.
bool HypothesisPool::Optimize(const Eigen::Isometry3d& T_start) {
  Eigen::Isometry3d T = T_start;
  for (const double width : kWidths) {
    T = MinimizeSampson(sampson_, T, width * options_.max_error_px, kIterationsPerWidth, Stride());
    if (IsOptimum(T)) return false;
  }
  optima_.push_back({T, sampson_.Score(T, options_.max_error_px).gain});
  if (optima_.back().gain > optima_[best_optimum_].gain) best_optimum_ = optima_.size() - 1;
  return true;
}

void HypothesisPool::OptimizeProposals() {
  std::stable_sort(proposals_.begin(), proposals_.end(),
                   [](const Pose& a, const Pose& b) { return a.gain > b.gain; });
  int num_left = 2 * options_.max_num_hypotheses;
  for (const Pose& proposal : proposals_) {
    if (proposal.gain < kMinRelativeGain * best_proposal_ || num_left-- == 0) return;
    Optimize(proposal.T_cand_query);
  }
}

// Again from the new best optimum where that led to one.
void HypothesisPool::LeaveBest() {
  for (int round = 0; round < kMaxRounds; ++round) {
    const size_t left = best_optimum_;
    LeaveOptimum(left);
    if (best_optimum_ == left) return;
  }
}

void HypothesisPool::LeaveOptimum(size_t optimum) {
  const Eigen::Isometry3d T = optima_[optimum].T_cand_query;
  const SampsonSystem system = sampson_.Linearize(T, kWidths[2] * options_.max_error_px);
  const Vector6d direction = LeastDetermined(system.JtJ);
  if (!direction.allFinite()) return;
  for (const double leap : kLeaps) {
    Optimize(T * ExpSE3(leap * options_.max_same_distance_m * direction));
  }
}

HypothesisPool::Pose HypothesisPool::Converged(const Pose& pose) const {
  const Eigen::Isometry3d T = MinimizeSampson(sampson_, pose.T_cand_query,
                                              kWidths[2] * options_.max_error_px, kFinalIterations);
  return {T, sampson_.Score(T, options_.max_error_px).gain};
}

RigHypothesis HypothesisPool::HypothesisOf(const Pose& pose) const {
  RigHypothesis hypothesis;
  hypothesis.T_cand_query = pose.T_cand_query;
  hypothesis.inliers = sampson_.Inliers(pose.T_cand_query, options_.max_error_px);
  hypothesis.num_inliers = 0;
  for (const std::vector<int>& inliers : hypothesis.inliers) {
    hypothesis.num_inliers += static_cast<int>(inliers.size());
  }
  hypothesis.cost =
      sampson_.NumMatches() * options_.max_error_px * options_.max_error_px - pose.gain;
  return hypothesis;
}

bool HypothesisPool::AreSame(const RigHypothesis& a, const RigHypothesis& b) const {
  const Vector6d xi = LogSE3(a.T_cand_query.inverse() * b.T_cand_query);
  if (xi.head<3>().norm() > options_.max_same_angle_rad ||
      xi.tail<3>().norm() > options_.max_same_distance_m) {
    return false;
  }
  int common = 0;
  for (size_t p = 0; p < a.inliers.size(); ++p) {
    common += NumIntersecting(a.inliers[p], b.inliers[p]);
  }
  return common >= options_.min_same_overlap * (a.num_inliers + b.num_inliers - common);
}

std::vector<RigHypothesis> HypothesisPool::Distinct() {
  if (optima_.empty()) return {};
  OptimizeProposals();
  LeaveBest();
  std::stable_sort(optima_.begin(), optima_.end(),
                   [](const Pose& a, const Pose& b) { return a.gain > b.gain; });
  const double min_gain = kMinRelativeOptimum * optima_.front().gain;
  size_t num_kept = 0;
  while (num_kept < optima_.size() && optima_[num_kept].gain >= min_gain &&
         static_cast<int>(num_kept) < options_.max_num_hypotheses) {
    optima_[num_kept] = Converged(optima_[num_kept]);
    ++num_kept;
  }
  optima_.resize(num_kept);
  std::stable_sort(optima_.begin(), optima_.end(),
                   [](const Pose& a, const Pose& b) { return a.gain > b.gain; });
  std::vector<RigHypothesis> distinct;
  for (const Pose& pose : optima_) {
    RigHypothesis hypothesis = HypothesisOf(pose);
    if (hypothesis.num_inliers < options_.min_num_inliers) continue;
    const bool is_new =
        std::none_of(distinct.begin(), distinct.end(),
                     [&](const RigHypothesis& better) { return AreSame(better, hypothesis); });
    if (is_new) distinct.push_back(std::move(hypothesis));
  }
  return distinct;
}

}  // namespace covinz
