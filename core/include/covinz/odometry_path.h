// What a session's odometry said, keyframe by keyframe, of all that are logged.
#pragma once

#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/odometry.h"

namespace covinz {

// Keyframes nearer in time say more about odometry's noise than about a twist. [s]
constexpr double kMinTwistStepS = 5e-3;
// No robot is faster, only odometry that jumps. [rad/s, m/s]
constexpr double kMaxTwist = 100.0;

// Poses and covariances of a session in order of their sequence numbers, whatever the order of
// arrival. A keyframe that is asked for must have been inserted: all throw std::invalid_argument
// otherwise.
class OdometryPath {
 public:
  using Twists = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;

  explicit OdometryPath(const OdometryNoise& noise) : noise_(noise) {}

  // Adds a keyframe, with the covariance of the motion since seq - 1 if its robot sent one. Throws
  // std::invalid_argument where it is there already.
  void Insert(int64_t seq,
              int64_t stamp_ns,
              const Eigen::Isometry3d& T_odom_body,
              const std::optional<Matrix6d>& covariance);

  // How many keyframes follow on a sequence number.
  size_t NumAfter(int64_t seq) const;

  // As long as it stays equal, so do all motions and twists up to a keyframe. A path only ever
  // grows, so the number of keyframes up to that one says which they are; the one that follows
  // gives it its second twist.
  std::pair<size_t, std::optional<int64_t>> State(int64_t last) const;

  // Of the motion between two keyframes, first <= last, in the later body frame. A step over
  // keyframes that are missing has none of the robot's: that speaks of the motion since seq - 1.
  Matrix6d Covariance(int64_t first, int64_t last) const;

  // How the body moved before and after a keyframe, [rad/s, m/s] in its frame: the means over the
  // steps to its neighbours; where there is one at one side only, it stands for both. None without
  // any neighbour at another time.
  std::optional<Twists> TwistsOf(int64_t seq) const;

 private:
  struct Node {
    int64_t seq;
    int64_t stamp_ns;
    Eigen::Isometry3d T_odom_body;
    std::optional<Matrix6d> covariance;
  };

  // The first keyframe with this sequence number or a later one.
  size_t LowerBound(int64_t seq) const;
  size_t Position(int64_t seq) const;
  std::optional<Vector6d> MeanTwist(const Node& node, const Node& other) const;

  OdometryNoise noise_;
  std::vector<Node> nodes_;
};

}  // namespace covinz
