// A session's odometry in order of sequence numbers.
#include "covinz/odometry_path.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace covinz {

void OdometryPath::Insert(int64_t seq,
                          int64_t stamp_ns,
                          const Eigen::Isometry3d& T_odom_body,
                          const std::optional<Matrix6d>& covariance) {
  const size_t at = LowerBound(seq);
  if (at < nodes_.size() && nodes_[at].seq == seq) {
    throw std::invalid_argument("Odometry path: " + std::to_string(seq) + " is logged twice");
  }
  const std::optional<Matrix6d> usable = covariance ? UsableCovariance(*covariance) : std::nullopt;
  nodes_.insert(nodes_.begin() + static_cast<std::ptrdiff_t>(at),
                Node{seq, stamp_ns, T_odom_body, usable});
}

size_t OdometryPath::NumAfter(int64_t seq) const {
  const size_t at = LowerBound(seq);
  const bool is_there = at < nodes_.size() && nodes_[at].seq == seq;
  return nodes_.size() - at - (is_there ? 1 : 0);
}

std::pair<size_t, std::optional<int64_t>> OdometryPath::State(int64_t last) const {
  const size_t count = Position(last) + 1;
  if (count == nodes_.size()) return {count, std::nullopt};
  return {count, nodes_[count].seq};
}

Matrix6d OdometryPath::Covariance(int64_t first, int64_t last) const {
  const size_t begin = Position(first);
  const size_t end = Position(last);
  std::vector<MotionStep> steps;
  for (size_t at = begin + 1; at <= end; ++at) {
    const Node& prev = nodes_[at - 1];
    const Node& cur = nodes_[at];
    const bool is_next = cur.seq == prev.seq + 1;
    steps.push_back(
        {prev.T_odom_body.inverse() * cur.T_odom_body, is_next ? cur.covariance : std::nullopt});
  }
  return MotionCovariance(steps, noise_);
}

std::optional<OdometryPath::Twists> OdometryPath::TwistsOf(int64_t seq) const {
  const size_t at = Position(seq);
  std::optional<Vector6d> before, after;
  if (at > 0) before = MeanTwist(nodes_[at], nodes_[at - 1]);
  if (at + 1 < nodes_.size()) after = MeanTwist(nodes_[at], nodes_[at + 1]);
  if (!before) before = after;
  if (!after) after = before;
  if (!before) return std::nullopt;
  Twists twists;
  twists << before->transpose(), after->transpose();
  return twists;
}

size_t OdometryPath::LowerBound(int64_t seq) const {
  const auto found = std::lower_bound(nodes_.begin(), nodes_.end(), seq,
                                      [](const Node& node, int64_t s) { return node.seq < s; });
  return static_cast<size_t>(found - nodes_.begin());
}

size_t OdometryPath::Position(int64_t seq) const {
  const size_t at = LowerBound(seq);
  if (at == nodes_.size() || nodes_[at].seq != seq) {
    throw std::invalid_argument("Odometry path: " + std::to_string(seq) + " is not logged");
  }
  return at;
}

std::optional<Vector6d> OdometryPath::MeanTwist(const Node& node, const Node& other) const {
  const double seconds = 1e-9 * static_cast<double>(other.stamp_ns - node.stamp_ns);
  if (std::abs(seconds) < kMinTwistStepS) return std::nullopt;
  const Vector6d twist = LogSE3(node.T_odom_body.inverse() * other.T_odom_body) / seconds;
  return twist * std::min(1.0, kMaxTwist / std::max(twist.cwiseAbs().maxCoeff(), kMaxTwist));
}

}  // namespace covinz
