// The refined solutions of a loop, the best one first, and whether it is clearly the best.
#pragma once

#include <optional>
#include <vector>

#include "covinz/rig_hypotheses.h"
#include "rig_solution.h"

namespace covinz {

// The best of the refined hypotheses and those that it is not clearly ahead of, the best one first.
std::vector<RigSolution> FindContenders(const LoopProblem& problem,
                                        const std::vector<RigHypothesis>& hypotheses,
                                        const FastLoopOptions& options);

// A distinct solution that is nearly as good as the best one.
struct Rival {
  size_t contender;
  double significance;  // of the best one's lead
};
std::optional<Rival> FindRival(const LoopProblem& problem,
                               const std::vector<RigSolution>& contenders,
                               const FastLoopOptions& options);

// Where the first choice is not clear: the best solution is left along the direction that it
// determines least, and contenders that the other's matches pull into the best one are dropped.
// What then is ambiguous, or has too few inliers, stays so: the search ends with the first rival
// found. Otherwise every hypothesis of a sampling that does not stop early is refined, and the test
// made again.
std::vector<RigSolution> SearchOn(const LoopProblem& problem,
                                  std::vector<RigSolution> contenders,
                                  const FastLoopOptions& options);

}  // namespace covinz
