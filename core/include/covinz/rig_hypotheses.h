// Joint robust estimation: the relative poses that the raw matches of two rigs support.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/rig_relative_pose.h"
#include "covinz/rig_sampson.h"
#include "covinz/upright_relative_pose.h"

namespace covinz {

// Options of EstimateRigHypotheses.
struct RigHypothesisOptions {
  // A match is an inlier up to this Sampson error [px].
  double max_error_px = 3.0;
  // Stop when the pose with the most inliers would have been found with this probability. High,
  // since a second pose with fewer inliers is to be found as well: with 80 % of them it then has 95
  // %.
  double confidence = 0.9999;
  int min_num_iterations = 50;
  int max_num_iterations = 1000;
  // Rays of other pairs that are tried for the distance of each promising pose of one pair.
  int num_scale_rays = 5;
  // Hypotheses with fewer inliers in all are not reported.
  int min_num_inliers = 12;
  int max_num_hypotheses = 10;
  // Two hypotheses are distinct when they are further apart than this [m], [rad], or share a
  // smaller part of their inliers (intersection over union).
  double max_same_distance_m = 0.1;
  double max_same_angle_rad = 0.026;
  double min_same_overlap = 0.5;
  // Where both keyframes know the vertical, every other sample is an upright one of four matches.
  std::optional<Verticals> verticals = std::nullopt;
  // Its error on either side [rad], per axis. [half a degree: visual-inertial odometry]
  double vertical_sigma_rad = 0.0087;
  InstructionSet instruction_set = BestInstructionSet();

  void Check() const;  // throws std::invalid_argument
};

struct RigHypothesis {
  Eigen::Isometry3d T_cand_query;         // metric
  std::vector<std::vector<int>> inliers;  // for each of rigs.pairs, ascending
  int num_inliers;
  double cost;  // of MSAC: sum over all matches of min(error^2, max_error^2) [px^2]
};

// Mutually distinct hypotheses, ascending in cost; empty where none has min_num_inliers, so for
// matches of a single pair and for rigs without baseline, whose scale is unobservable.
//
// A sample is five matches of one pair, drawn in proportion to the pairs' matches, and single ones
// of the others (generalized_relative_pose.h). There is no least number of matches per pair. Poses
// that explain few matches of their own pair are dropped before any distance is tried. The best
// poses are optimised locally over all matches, the rigs held rigid (sampson_minimization.h). Wrong
// loops are mostly second solutions, translation traded for rotation about the scene's depth: so
// several hypotheses survive, and each optimum is also left along the direction that it determines
// least.
//
// Verticals only propose (upright_relative_pose.h): half a degree moves a ray by 4 px. Such a pose
// is scored within that error and optimised before it is compared with others.
//
// Same seed and input, same result on every instruction set. Throws std::invalid_argument on
// malformed input.
//
// Source: Fischler and Bolles, "Random sample consensus", 1981; Chum, Matas, Kittler, "Locally
// optimized RANSAC", DAGM 2003; Torr and Zisserman, "MLESAC", CVIU 2000 (MSAC); decision 0019.
std::vector<RigHypothesis> EstimateRigHypotheses(const RigPairs& rigs,
                                                 const RigHypothesisOptions& options,
                                                 uint64_t seed);

}  // namespace covinz
