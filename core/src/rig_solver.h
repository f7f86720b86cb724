// The 17-point solver on subsets of the matches of two rigs.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Geometry>
#include <opengv/relative_pose/NoncentralRelativeAdapter.hpp>

#include "covinz/random.h"
#include "covinz/rig_relative_pose.h"

namespace covinz {

// Solved between the frames of the rigs' first cameras, not the bodies: when a robot moves straight
// all centres of a rig lie on one line, and the linear equations leave E unique only if the origin
// is on that line (Li et al., "axial" cameras). With a camera 0.3 m off the body, solving between
// the bodies loses half of the covariances and takes seven times as many iterations.
//
// Source: Li, Hartley, Kim, CVPR 2008; COVINS-G, III-B2 (samples from all pairs).
class SeventeenPointSolver {
 public:
  static constexpr int kSampleSize = 17;

  // Solves on the given matches of each pair; the rigs must outlive the solver.
  SeventeenPointSolver(const RigPairs& rigs, const std::vector<std::vector<int>>& subset);
  // OpenGV's adapter refers to the other members.
  SeventeenPointSolver(const SeventeenPointSolver&) = delete;
  SeventeenPointSolver& operator=(const SeventeenPointSolver&) = delete;

  // Rows of 17 matches: as many from every pair, the rest from any. With more than 17 pairs, one
  // from each of 17 of them.
  std::vector<int> DrawSample(Random& random) const;

  // T_cand_query, nullopt when the solution is not finite.
  std::optional<Eigen::Isometry3d> Solve(const std::vector<int>& sample) const;

  int NumMatches() const { return static_cast<int>(query_.size()); }

 private:
  Eigen::Isometry3d T_cand_cam0_;
  Eigen::Isometry3d T_cam0_query_;
  // OpenGV holds one list of cameras for both viewpoints: the candidate's first, the query's after.
  opengv::translations_t offsets_;
  opengv::rotations_t rotations_;
  opengv::bearingVectors_t cand_;
  opengv::bearingVectors_t query_;
  std::vector<int> cand_cams_;
  std::vector<int> query_cams_;
  std::vector<int> first_row_;  // of each pair, and one past the last
  opengv::relative_pose::NoncentralRelativeAdapter adapter_;
};

}  // namespace covinz
