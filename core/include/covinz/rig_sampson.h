// Sampson errors of all matches of two rigs at once: what the joint RANSAC scores and optimises.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "covinz/instruction_set.h"
#include "covinz/rig_relative_pose.h"
#include "covinz/se3.h"

namespace covinz {

struct SampsonTask;  // sampson_kernels.h

struct RigScore {
  // Sum over the inliers of max_error^2 - error^2 [px^2]: N max_error^2 less the cost of MSAC.
  double gain = 0.0;
  int num_inliers = 0;
};

// Weighted least squares of the Sampson errors in the right perturbation of T_cand_query (se3.h).
struct SampsonSystem {
  Matrix6d JtJ = Matrix6d::Zero();
  Vector6d Jte = Vector6d::Zero();
  // Sum of the robust costs [px^2] of all matches and its number of inliers.
  double cost = 0.0;
  int num_inliers = 0;
};

// The matches of two rigs as rays in the two body frames, prepared for the kernels. There, with
// R, t of T_cand_query, a match (q, c) between cameras at p_q and p_c has
//
//   r = R q,   b = R p_q + t - p_c,   e = c . (b x r),
//   error^2 = e^2 / (w_q (|c x b|^2 - e^2) + w_c (|b x r|^2 - e^2)),   w = 1 / focal^2,
//
// the error of SquaredSampsonError_px2 in epipolar.h. A match is an inlier when error <= max_error
// and its rays meet in front of both cameras (InFrontOfBoth).
//
// Single precision: rounding moves an error by less than 0.001 px. Every instruction set gives the
// same bits: matches are independent lanes, sums are of sixteen lanes whatever the width of a
// register, and multiplications are never fused with additions.
//
// Source: Sampson 1982; Torr and Zisserman, "MLESAC", CVIU 2000 (MSAC).
class RigSampson {
 public:
  // Throws std::invalid_argument on malformed input, or where this processor lacks the
  // instructions.
  explicit RigSampson(const RigPairs& rigs, InstructionSet instruction_set = BestInstructionSet());

  // Score of all matches.
  // With a stride, here and below: only of about every stride-th match of each pair.
  RigScore Score(const Eigen::Isometry3d& T_cand_query, double max_error_px, int stride = 1) const;

  // Score of the matches of one pair for a baseline b of any length.
  RigScore ScorePair(size_t pair,
                     const Eigen::Matrix3d& R_cand_query,
                     const Eigen::Vector3d& baseline,
                     double max_error_px,
                     int stride = 1) const;

  // Inliers of each pair, ascending.
  std::vector<std::vector<int>> Inliers(const Eigen::Isometry3d& T_cand_query,
                                        double max_error_px) const;

  // Normal equations of the biweight cost  k^2 / 3 (1 - (1 - error^2 / k^2)^3)  of inliers within
  // k = max_error_px, k^2 / 3 of the others: weights (1 - error^2 / k^2)^2. The denominator is
  // differentiated too; held constant it would shrink the scale.
  //
  // Source: Beaton and Tukey, "The fitting of power series", Technometrics 1974.
  SampsonSystem Linearize(const Eigen::Isometry3d& T_cand_query,
                          double max_error_px,
                          int stride = 1) const;

  size_t NumPairs() const { return pairs_.size(); }
  int NumMatches() const { return num_matches_; }
  int NumMatches(size_t pair) const { return pairs_[pair].num_matches; }

 private:
  struct Pair {
    Eigen::Vector3d query_centre, cand_centre;
    double query_weight, cand_weight;
    int num_matches;
    size_t first_block;
    size_t num_blocks;
  };

  SampsonTask TaskOf(size_t pair,
                     const Eigen::Matrix3d& R_cand_query,
                     const Eigen::Vector3d& translation,
                     double max_error_px) const;
  std::vector<SampsonTask> Tasks(const Eigen::Isometry3d& T_cand_query, double max_error_px) const;
  // Matches that a stride takes.
  size_t NumSampled(int stride) const;

  InstructionSet instruction_set_;
  std::vector<Pair> pairs_;
  int num_matches_ = 0;
  // Blocks of sixteen matches: q.x of all of them, q.y, q.z, c.x, c.y, c.z. The matches of a pair
  // are dealt out to its blocks in turn, so that some blocks show as much of the images as all.
  // Empty lanes are zero, which never lies in front.
  std::vector<float> rays_;
};

}  // namespace covinz
