// Relative pose of two single cameras: the pre-filter in front of the rig's RANSAC.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/epipolar.h"

namespace covinz {

// Options of EstimateRelativePose.
struct RelativePoseOptions {
  // A match is an inlier up to this Sampson error [px].
  double max_error_px = 2.0;
  // Stop when a better pose would have been found with this probability.
  double confidence = 0.99;
  int max_num_iterations = 1000;

  void Check() const;  // throws std::invalid_argument
};

struct RelativePose {
  Eigen::Isometry3d T_cand_query;  // translation of length 1: two views have no scale
  std::vector<int> inliers;        // positions in the pairs, ascending
  int num_iterations;
};

// RANSAC over the five-point algorithm. An inlier lies near its epipolar plane and in front of
// both cameras. Same seed and input, same result. Returns nullopt when no pose explains even five
// matches. Throws std::invalid_argument on malformed input.
//
// Source: COVINS-G, III-B2; Stewenius, Engels, Nister, "Recent developments on direct relative
// orientation", ISPRS J. 2006; minimal solver of OpenGV (Kneip, Furgale, ICRA 2014).
std::optional<RelativePose> EstimateRelativePose(const BearingPairs& pairs,
                                                 const RelativePoseOptions& options,
                                                 uint64_t seed);

// Iterations after which RANSAC has drawn an all-inlier sample with the wanted confidence, when a
// sample is one with probability good_sample; at most max_num_iterations.
int NumRansacIterations(double good_sample, double confidence, int max_num_iterations);

}  // namespace covinz
