// The inner loop of the rig refinement on blocks of eight tracks, one version per instruction set:
// residuals, normal equations and the elimination of the points.
#pragma once

#include <cstddef>

#include "covinz/instruction_set.h"

namespace covinz {

// Tracks of a block, one a lane. An array over lanes has this many doubles.
inline constexpr size_t kTrackLanes = 8;

// Pose of a camera in the world; camera 0 is the world itself.
struct AdjustmentPose {
  double R[9];  // row-major
  double t[3];
};

// A block of tracks as seen by one camera. Arrays are over lanes; zero where the camera has no
// keypoint of the track.
struct AdjustmentView {
  int camera;
  double bearing[3 * kTrackLanes];
  double whitened_basis[6 * kTrackLanes];  // row by row
};

// Notation of rig_adjustment.cc: V and g are the equations of a point, W those that couple it with
// a camera.
struct PointEquations {
  double inverse_V[6 * kTrackLanes];  // upper triangle, row by row
  double g[3 * kTrackLanes];
};
struct CouplingEquations {
  double W[18 * kTrackLanes];  // 6 x 3, row by row
};

struct AdjustmentTask {
  const AdjustmentPose* poses;  // by camera
  const AdjustmentView* views;  // by block, in it ascending in camera
  const size_t* begins;         // first view of each block, and one past the last view
  size_t num_blocks;
  const double* points;  // of each block: direction, inverse distance, all over lanes
  double keypoint_loss2;
  double direction_information;
  double inverse_distance_information;
  double damping;
};

// What LinearizeTracks writes; the arrays must have room for it. The first two are over lanes, to
// be summed (SumLanes), and are added to.
struct TrackEquations {
  // Blocks of 6 x 6, row by row, of cameras a >= b >= 1 at [(a - 1) a / 2 + b - 1]; of a == b the
  // lower triangle only.
  double* hessian;
  double* gradient;  // 6 a camera from the second on
  PointEquations* points;
  CouplingEquations* couplings;  // by view
};

// Returns the cost of the tracks.
double LinearizeTracks(InstructionSet instruction_set,
                       const AdjustmentTask& task,
                       const TrackEquations& equations);

// In the same order on every instruction set.
double SumLanes(const double* lanes);

}  // namespace covinz
