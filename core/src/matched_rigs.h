// Matching of all camera pairs of two rigs, without the pairwise stages of the paper.
#pragma once

#include <vector>

#include "covinz/instruction_set.h"
#include "covinz/matching.h"
#include "covinz/rig_relative_pose.h"
#include "covinz/solve_loop.h"

namespace covinz {

struct MatchedRigs {
  RigPairs rigs;                              // the query camera outermost
  std::vector<std::vector<Match>> keypoints;  // of each match: rows of the cameras' features
};

// Matches keypoints that have a bearing. Throws std::invalid_argument on malformed cameras,
// or where the processor lacks the instruction set.
MatchedRigs MatchRigs(const std::vector<RigCamera>& query,
                      const std::vector<RigCamera>& cand,
                      const MatchingOptions& options,
                      InstructionSet instruction_set);

}  // namespace covinz
