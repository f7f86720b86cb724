// The poses that RANSAC proposes: local optimisation and the choice of mutually distinct ones.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/rig_hypotheses.h"
#include "covinz/rig_sampson.h"

namespace covinz {

// The sampson and the options must outlive the pool.
class HypothesisPool {
 public:
  HypothesisPool(const RigSampson& sampson, const RigHypothesisOptions& options)
      : sampson_(sampson), options_(options) {}

  // Stride with which to look at the matches where a part of them is enough.
  int Stride() const;

  // Takes a pose from a minimal sample. One that is better than all before it is optimised at once,
  // since its inliers decide when RANSAC ends. Returns whether there is a new best pose.
  bool Propose(const Eigen::Isometry3d& T_cand_query);

  // Takes a pose that may be wrong by width_px; it is optimised before it is proposed if it is
  // among the better ones of its kind.
  bool ProposeRough(const Eigen::Isometry3d& T_cand_query, double width_px);

  // Inliers of each pair of the best pose so far.
  std::vector<std::vector<int>> BestInliers() const;

  // Optimises the best proposals, and poses off the best optimum, and returns the distinct ones,
  // ascending in cost.
  std::vector<RigHypothesis> Distinct();

 private:
  struct Pose {
    Eigen::Isometry3d T_cand_query;
    double gain;  // of RigScore
  };

  void OptimizeProposals();
  void LeaveBest();
  void LeaveOptimum(size_t optimum);
  bool Optimize(const Eigen::Isometry3d& T_start);
  bool IsOptimum(const Eigen::Isometry3d& T_cand_query) const;
  Pose Converged(const Pose& pose) const;
  RigHypothesis HypothesisOf(const Pose& pose) const;
  bool AreSame(const RigHypothesis& a, const RigHypothesis& b) const;

  const RigSampson& sampson_;
  const RigHypothesisOptions& options_;
  std::vector<Pose> proposals_;
  double best_proposal_ = 0.0;  // its gain
  double best_rough_ = 0.0;     // likewise, of rough ones
  std::vector<Pose> optima_;
  size_t best_optimum_ = 0;
};

}  // namespace covinz
