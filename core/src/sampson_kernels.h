// The inner loops of RigSampson on blocks of eight matches, one version per instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

#include "covinz/rig_sampson.h"

namespace covinz {

inline constexpr size_t kLanes = 8;
inline constexpr size_t kBlockSize = 6 * kLanes;

// A pose as seen by the matches of one pair; notation of RigSampson.
struct SampsonPose {
  double R[9];  // row-major
  double b[3];
  double query_weight, cand_weight;
  double max_error2;  // [px^2]
  double max_sine2;   // below, rays count as parallel
};

// Sums over the inliers of the blocks.
struct SampsonSums {
  double gain;
  double num_inliers;
};

// Of the rows J = d error / d (theta, b), where R moves to Exp(theta) R, with their weights.
struct SampsonNormalSums {
  double JtJ[21];  // upper triangle, row by row
  double Jte[6];
  double cost;  // of the inliers
  double num_inliers;
};

// Of every stride-th block.
SampsonSums ScoreBlocks(InstructionSet instruction_set,
                        const SampsonPose& pose,
                        const double* blocks,
                        size_t num_blocks,
                        size_t stride);

// inliers[i] is 1 for an inlier, else 0; kLanes a block.
void MarkInliers(InstructionSet instruction_set,
                 const SampsonPose& pose,
                 const double* blocks,
                 size_t num_blocks,
                 int64_t* inliers);

SampsonNormalSums LinearizeBlocks(InstructionSet instruction_set,
                                  const SampsonPose& pose,
                                  const double* blocks,
                                  size_t num_blocks,
                                  size_t stride);

}  // namespace covinz
