// Which keyframes around a reference make the best rig, by odometry and calibration alone.
//
// What a rig is for is scale: odometry knows how far apart its cameras are, and nothing else does.
// Two of its cameras, a baseline b apart, tell the scale with the information
//
//   shared * b^2 / sigma^2
//
// where sigma is odometry's error over the path between them, and shared is the part of the
// reference's matches that both of them can have. Information adds up along a rig in order of time,
// since odometry's errors of consecutive stretches are independent: two cameras beside each other
// count little more than one. Distant cameras have long baselines, but less of the view in common,
// see it from other sides, and odometry's rotation has drifted by more than the search for
// hypotheses, which holds rigs rigid, forgives: all three are in `shared`.
//
// Source: decision 0021.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "covinz/camera_view.h"
#include "covinz/odometry.h"

namespace covinz {

// Options of ChooseRig.
struct RigNeighboursOptions {
  // Distance of the scene where it matters what two cameras share [m].
  double depth_m = 2.0;
  // Change of a point's viewing direction [rad], or of the logarithm of its distance, that costs
  // half of the matches.
  double half_view_change = 0.35;
  // Cameras in whose view less than this part of the reference's view is are taken only where there
  // are no better ones.
  double min_overlap = 0.5;
  // Keyframes further along the path are not looked at [m], but for the few next to the reference.
  double max_path_m = 2.0;
  int min_steps = 4;
  // Matches stay inliers of a hypothesis up to this error [px].
  double max_error_px = 3.0;
  OdometryNoise odometry;

  void Check() const;  // throws std::invalid_argument
};

struct RigChoice {
  std::vector<int> rows;  // the reference first, then the others in order of time
  double information;     // about scale: one over the relative variance
};

// The best rig of `size` keyframes, or of all where there are fewer, around a reference. Where too
// few have enough of the reference's view, the places left go to those that can be matched best
// with it, of equal ones to the nearest. Only motions between the keyframes count, not the
// odometry's frame.
//
// T_odom_body and views are those of consecutive keyframes of a session in order of time. Throws
// std::invalid_argument where they do not fit.
RigChoice ChooseRig(const std::vector<Eigen::Isometry3d>& T_odom_body,
                    const std::vector<const CameraView*>& views,
                    int reference,
                    int size,
                    const RigNeighboursOptions& options);

}  // namespace covinz
