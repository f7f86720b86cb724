// Whether the matches of two rigs can tell the scale of their relative pose.
#pragma once

#include <cstdint>

#include "covinz/relative_pose.h"
#include "covinz/rig_relative_pose.h"

namespace covinz {

// Options of CommonCentreRatio and the limit on its result.
struct RigScaleOptions {
  // Scale counts as unobservable when cameras without any baseline explain a larger part of the
  // inliers than this; 1 accepts all. [not in the paper: noise makes the linear solution shrink,
  // and all covariance samples shrink alike. On generated loops the ordinary ratio is 0.1 to 0.5
  // with a mean NEES of 1 to 4; above 0.8 the NEES is 10 to 80. On real images it costs 4 % of the
  // loops]
  double max_common_centre_ratio = 0.8;
  // Of the five-point RANSAC over the inliers of all pairs. At a ratio near the limit 20 samples
  // find the model with a probability of 0.9996 (1 - (1 - 0.8^5)^20).
  double max_error_px = 2.0;
  int max_num_iterations = 20;

  void Check() const;  // throws std::invalid_argument
};

// Part of the estimate's inliers that one central camera on each side explains as well: the rigs
// with all their cameras moved to one centre, their rotations kept. Near 1 for rigs without
// baseline, for a scene so far away that the baselines do not show, and for matches of a single
// camera pair.
//
// Source: model selection after Torr, "An assessment of information criteria for motion model
// selection", CVPR 1997: the simpler model suffices.
double CommonCentreRatio(const RigPairs& rigs,
                         const RigRelativePose& estimate,
                         const RigScaleOptions& options,
                         uint64_t seed);

}  // namespace covinz
