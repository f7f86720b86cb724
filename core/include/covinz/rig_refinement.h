// A small bundle adjustment of two camera rigs: their relative pose, their own shape and the points
// that both see.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "covinz/bearing_residual.h"
#include "covinz/instruction_set.h"
#include "covinz/rig_exposure.h"
#include "covinz/rig_tracks.h"
#include "covinz/se3.h"

namespace covinz {

// What odometry says about the motion between two cameras of one rig.
struct RigMotion {
  int from;  // positions in the rig
  int to;
  // Of the right perturbation of T_from_to in the frame of camera `to`, [rotation, translation],
  // [rad, m]; positive definite.
  Matrix6d covariance;
};

// The cameras of a rig as odometry has them. The first one belongs to the reference keyframe: its
// pose is a calibration and stays.
struct RefinedRig {
  std::vector<Eigen::Isometry3d> T_rig_cam;
  std::vector<double> focal_px;    // one pixel is 1 / focal radians
  std::vector<RigMotion> motions;  // must tie every camera to the first
  // By camera; none where all images are of their stamps' very moments. Not looked at by the
  // refinement, which takes motions as given: see MotionsBetweenImages.
  std::vector<CameraExposure> exposures;

  void Check() const;  // throws std::invalid_argument
};

// Options of RefineRigs.
struct RigRefinementOptions {
  // Standard deviation of a keypoint [px], per axis; what the residuals show of it is the matter of
  // rig_covariance.h. [1 px: FAST corners on OpenCV's pyramid, from 0.5 px on its first level]
  double sigma_px = 1.0;
  // Cauchy loss of a keypoint, in standard deviations: keeps 92 % of the efficiency of least
  // squares on normal errors. [Hampel et al., "Robust Statistics", 1986]
  double keypoint_loss = 2.5;
  // Degrees of freedom of the Student distribution of a rig's motion: odometry has heavy tails.
  // [Lange, Little, Taylor, "Robust statistical modeling using the t distribution", JASA 1989]
  double motion_dof = 4.0;
  // Keeps points finite towards the camera: standard deviation of the inverse distance [1/m].
  double max_inverse_distance_per_m = 10.0;
  // A keypoint is an inlier up to this error [px] after the refinement.
  double max_error_px = 2.0;
  // Mostly 5 are enough. A refinement that is cut off starts the next round with points
  // triangulated anew, so that with 8 it may not get on at all, which takes longer; with 24 it ends
  // on the matches of the first choice, however wrong they are, before they are chosen anew.
  int max_num_iterations = 12;
  // Stop when an iteration lowers the cost by less than this part.
  double min_relative_decrease = 1e-4;
  InstructionSet instruction_set = BestInstructionSet();

  void Check() const;  // throws std::invalid_argument
};

struct RigRefinement {
  Eigen::Isometry3d T_cand_query;             // bodies of the two reference keyframes
  std::vector<Eigen::Isometry3d> T_cand_cam;  // refined camera poses in the rigs' body frames
  std::vector<Eigen::Isometry3d> T_query_cam;
  double cost;  // of keypoints and motions, see RefineRigs
  // For each motion of the candidate's rig, then of the query's: the motion found less the one
  // measured, in standard deviations of the latter (its covariance's Cholesky factor).
  std::vector<Vector6d> motion_residuals;
  std::vector<bool> inliers;  // for each observation of the tracks
  int num_inlier_tracks;      // all observations of which are inliers
  // Of each track, in the frame of the candidate's first camera.
  std::vector<InverseDistancePoint> points;
  int num_iterations;
};

// Where a refinement starts: camera poses in the rigs' body frames and the rigs' relative pose.
struct RigPoses {
  std::vector<Eigen::Isometry3d> T_cand_cam;
  std::vector<Eigen::Isometry3d> T_query_cam;
  Eigen::Isometry3d T_cand_query;
};

// Minimises, over the poses of all cameras but the candidate's first and over the points,
//
//   sum_observations rho_c(|e_ti|^2) + sum_motions rho_m(|L^-1 Log(T_ij_odometry^-1 T_ij)|^2)
//     + sum_points (w_t / max_inverse_distance)^2,     rho_c(s) = c^2 log(1 + s / c^2)
//
// with e of bearing_residual.h, L L^T the covariance of a motion, and for motions c^2 = dof + 6.
// Levenberg-Marquardt; points are eliminated (Schur complement), so a step solves for 24 unknowns
// for the usual 2 + 3 cameras. Points start triangulated at the given poses.
//
// Deterministic. Throws std::invalid_argument on malformed input, for tracks or a start of other
// cameras than the rigs have, and where the processor lacks the instruction set.
//
// Source: Triggs et al., "Bundle adjustment: a modern synthesis", 1999; decision 0020.
RigRefinement RefineRigs(const RefinedRig& cand,
                         const RefinedRig& query,
                         const RigTracks& tracks,
                         const RigPoses& start,
                         const RigRefinementOptions& options);

// Starts with the rigs as odometry has them.
RigRefinement RefineRigs(const RefinedRig& cand,
                         const RefinedRig& query,
                         const RigTracks& tracks,
                         const Eigen::Isometry3d& T_cand_query,
                         const RigRefinementOptions& options);

}  // namespace covinz
