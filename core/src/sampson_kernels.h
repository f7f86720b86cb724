// The inner loops of RigSampson on blocks of sixteen matches, one version per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "covinz/rig_sampson.h"

namespace covinz {

inline constexpr size_t kLanes = 16;
inline constexpr size_t kBlockSize = 6 * kLanes;

// A pose as seen by the matches of one pair, and their blocks; notation of RigSampson.
struct SampsonTask {
  float R[9];  // row-major
  float b[3];
  float lever[3];  // R p_q
  float query_weight, cand_weight;
  float max_error2;  // [px^2]
  float max_sine2;   // below, rays count as parallel
  const float* blocks;
  size_t num_blocks;
};

// Sums over the inliers of the blocks.
struct SampsonSums {
  double gain;
  double num_inliers;
};

// Of the rows J = d error / d (theta, rho), where the pose moves to Exp(theta, rho) T_cand_query,
// with their weights.
struct SampsonNormalSums {
  double JtJ[21];  // upper triangle, row by row
  double Jte[6];
  double cost;  // of the inliers
  double num_inliers;
};

// Of every stride-th block of each task.
SampsonSums ScoreBlocks(InstructionSet instruction_set,
                        const SampsonTask* tasks,
                        size_t num_tasks,
                        size_t stride);

// inliers[i] is 1 for an inlier, else 0; kLanes a block.
void MarkInliers(InstructionSet instruction_set, const SampsonTask& task, int32_t* inliers);

// All tasks must have the same max_error2.
SampsonNormalSums LinearizeBlocks(InstructionSet instruction_set,
                                  const SampsonTask* tasks,
                                  size_t num_tasks,
                                  size_t stride);

}  // namespace covinz
