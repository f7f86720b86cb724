// From a hypothesis to a refined solution: tracks of its inliers, adjustment, score on all matches.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "covinz/rig_refinement.h"
#include "covinz/rig_selection.h"
#include "covinz/rig_tracks.h"
#include "covinz/solve_loop_fast.h"
#include "matched_rigs.h"

namespace covinz {

// Everything that refinement and selection work on.
struct LoopProblem {
  MatchedRigs matched;
  RefinedRig query;
  RefinedRig cand;
};

// A refined hypothesis.
struct RigSolution {
  RigTracks tracks;
  RigRefinement refinement;
  SolutionScore score;

  RigPoses Poses() const {
    return {refinement.T_cand_cam, refinement.T_query_cam, refinement.T_cand_query};
  }
};

// As far as ranking needs it, from odometry's rigs.
RigSolution RefineTrial(const LoopProblem& problem,
                        const std::vector<std::vector<int>>& inliers,
                        const Eigen::Isometry3d& T_cand_query,
                        const FastLoopOptions& options);
// Likewise, from the given poses.
RigSolution RefineTrial(const LoopProblem& problem,
                        const std::vector<std::vector<int>>& inliers,
                        const RigPoses& start,
                        const FastLoopOptions& options);

// From the given poses over the given inliers, then each time over all matches that the last
// refinement explains, until the adjustment has converged and these hardly grow any more: rigs that
// are still as odometry has them explain but a part.
RigSolution RefineToTheEnd(const LoopProblem& problem,
                           RigPoses start,
                           std::vector<std::vector<int>> inliers,
                           const FastLoopOptions& options);
RigSolution RefineToTheEnd(const LoopProblem& problem,
                           const RigSolution& trial,
                           const FastLoopOptions& options);

}  // namespace covinz
