// The least-squares problem of RefineRigs: its unknowns, cost, normal equations and steps.
#pragma once

#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "adjustment_kernels.h"
#include "covinz/bearing_residual.h"
#include "covinz/rig_refinement.h"

namespace covinz {

// A motion between two of the cameras of both rigs, with odometry's T_from_to.
struct AdjustedMotion {
  int from;
  int to;
  Eigen::Isometry3d T_from_to;
  Matrix6d whitening;  // L^-1, L L^T the covariance
};

// The tracks as the kernels take them, those of the same cameras side by side.
struct TrackBlocks {
  std::vector<AdjustmentView> views;
  std::vector<size_t> begins = {0};  // first view of each block, and one past the last view
  std::vector<int> tracks;           // of each lane of each block; negative for empty lanes

  size_t size() const { return begins.size() - 1; }
};

// What is measured. Cameras are numbered as in RigTracks; camera 0 is the world.
struct RigAdjustment {
  int num_cameras = 0;
  std::vector<AdjustedMotion> motions;
  std::vector<BearingMeasurement> observations;
  std::vector<int> begins;  // of each track, and one past the last observation
  TrackBlocks blocks;       // of all tracks, where equations are wanted
  InstructionSet instruction_set = InstructionSet::kPortable;
  double keypoint_loss2 = 0.0;  // c^2 of the losses
  double motion_loss2 = 0.0;
  double inverse_distance_information = 0.0;

  size_t NumTracks() const { return begins.size() - 1; }
  // Information on a point before its keypoints. That on the direction only keeps a point finite
  // all of whose keypoints are outliers.
  static constexpr double kDirectionInformation = 1e-6;
  Eigen::Matrix3d PointInformation() const {
    return Eigen::Vector3d(kDirectionInformation, kDirectionInformation,
                           inverse_distance_information)
        .asDiagonal();
  }
  // Unknowns of the cameras: six each but for camera 0.
  Eigen::Index NumCameraUnknowns() const { return 6 * (num_cameras - 1); }
};

// The unknowns.
struct RigAdjustmentState {
  std::vector<Eigen::Isometry3d> T_world_cam;
  std::vector<InverseDistancePoint> points;  // by track
};

// Throws std::invalid_argument for tracks of cameras that the rigs do not have; rigs and options
// must have been checked.
RigAdjustment MakeAdjustment(const RefinedRig& cand,
                             const RefinedRig& query,
                             const RigTracks& tracks,
                             const RigRefinementOptions& options);

// For RigAdjustment.blocks.
TrackBlocks BlockTracks(const RigAdjustment& problem);

// Poses of all cameras in the frame of the candidate's first.
std::vector<Eigen::Isometry3d> CamerasInWorld(const std::vector<Eigen::Isometry3d>& T_cand_cam,
                                              const std::vector<Eigen::Isometry3d>& T_query_cam,
                                              const Eigen::Isometry3d& T_cand_query);

// Normal equations of the cameras after elimination of the points, H delta = -gradient, and what
// brings the points' steps back.
struct ReducedSystem {
  Eigen::MatrixXd hessian;
  Eigen::VectorXd gradient;
  std::vector<PointEquations> points;        // by block
  std::vector<CouplingEquations> couplings;  // by view: J_cam^T J_point
  std::vector<double> lane_sums;             // working memory
};

// Loss and weight of a squared error: Cauchy's, w = d rho / d s.
struct RobustLoss {
  double cost;
  double weight;
};
RobustLoss CauchyLoss(double squared_error, double loss2);

// Loss of a motion, Student's: with dof + 6 in place of dof as the scale the weight is 1 where the
// residual is 0, so a motion that the images do not test keeps its own covariance.
RobustLoss MotionLoss(double squared_error, const RigRefinementOptions& options);

// Weight of a keypoint; one behind its camera has none.
inline double KeypointWeight(const RigAdjustment& problem, const BearingResidual& residual) {
  return residual.in_front ? 1.0 / (1.0 + residual.error.squaredNorm() / problem.keypoint_loss2)
                           : 0.0;
}

// Whitened residual of a motion and its Jacobians with respect to both cameras.
struct MotionResidual {
  Vector6d error;
  Matrix6d J_from;
  Matrix6d J_to;
};
MotionResidual EvaluateMotion(const AdjustedMotion& motion, const RigAdjustmentState& state);

// Needs the problem's blocks. Diagonals are multiplied by 1 + damping. Returns the cost of the
// state, a keypoint behind its camera counting as one at a right angle. Source: Marquardt 1963.
double Linearize(const RigAdjustment& problem,
                 const RigAdjustmentState& state,
                 double damping,
                 ReducedSystem& system);

RigAdjustmentState Step(const RigAdjustment& problem,
                        const RigAdjustmentState& state,
                        const ReducedSystem& system);

}  // namespace covinz
