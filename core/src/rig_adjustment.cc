// Cost, normal equations with the points eliminated, and steps of the rig refinement.
#include "rig_adjustment.h"

#include <cmath>
#include <stdexcept>

#include <Eigen/Cholesky>

#include "covinz/pose_graph_residual.h"

namespace covinz {
namespace {

using Matrix63 = Eigen::Matrix<double, 6, 3>;

// First unknown of a camera; negative for the fixed one.
Eigen::Index Unknown(int camera) { return 6 * (static_cast<Eigen::Index>(camera) - 1); }

// Returns their cost.
double AddMotions(const RigAdjustment& problem,
                  const RigAdjustmentState& state,
                  ReducedSystem& system) {
  double cost = 0.0;
  for (const AdjustedMotion& motion : problem.motions) {
    const MotionResidual residual = EvaluateMotion(motion, state);
    const RobustLoss loss = CauchyLoss(residual.error.squaredNorm(), problem.motion_loss2);
    const double weight = loss.weight;
    cost += loss.cost;
    const Eigen::Index from = Unknown(motion.from);
    const Eigen::Index to = Unknown(motion.to);
    if (from >= 0) {
      system.hessian.block<6, 6>(from, from) +=
          weight * residual.J_from.transpose() * residual.J_from;
      system.gradient.segment<6>(from) += weight * residual.J_from.transpose() * residual.error;
    }
    if (to >= 0) {
      system.hessian.block<6, 6>(to, to) += weight * residual.J_to.transpose() * residual.J_to;
      system.gradient.segment<6>(to) += weight * residual.J_to.transpose() * residual.error;
    }
    if (from >= 0 && to >= 0) {
      const Matrix6d cross = weight * residual.J_from.transpose() * residual.J_to;
      system.hessian.block<6, 6>(from, to) += cross;
      system.hessian.block<6, 6>(to, from) += cross.transpose();
    }
  }
  return cost;
}

// Adds the observations of a track and leaves the point's own equations in system.points. Returns
// the track's cost.
double AddObservations(const RigAdjustment& problem,
                       const RigAdjustmentState& state,
                       size_t track,
                       double damping,
                       ReducedSystem& system) {
  const InverseDistancePoint& x = state.points[track];
  const Eigen::Matrix<double, 2, 3> basis = TangentBasis(x.direction);
  Eigen::Matrix3d hessian = problem.PointInformation();
  Eigen::Vector3d gradient(0.0, 0.0, problem.inverse_distance_information * x.inverse_distance);
  // The sum of the logarithms of the losses: at most 32 factors of some 1e5.
  double product = 1.0;
  for (int i = problem.begins[track]; i < problem.begins[track + 1]; ++i) {
    const BearingMeasurement& measured = problem.observations[static_cast<size_t>(i)];
    const BearingResidual residual = EvaluateBearing(
        measured, x, basis, state.T_world_cam[static_cast<size_t>(measured.camera)]);
    const double weight = KeypointWeight(problem, residual);
    const double error2 = residual.in_front ? residual.error.squaredNorm()
                                            : measured.whitened_basis.row(0).squaredNorm();
    product *= 1.0 + error2 / problem.keypoint_loss2;
    const Eigen::Matrix<double, 2, 3> J_point = weight * residual.J_point;
    hessian.noalias() += J_point.transpose() * residual.J_point;
    gradient.noalias() += J_point.transpose() * residual.error;
    const Eigen::Index c = Unknown(measured.camera);
    if (c < 0) continue;
    const Eigen::Matrix<double, 2, 6> J_cam = weight * residual.J_cam;
    Matrix6d block = J_cam.transpose() * residual.J_cam;
    block.diagonal() *= 1.0 + damping;
    system.hessian.block<6, 6>(c, c) += block;
    system.gradient.segment<6>(c).noalias() += J_cam.transpose() * residual.error;
    system.couplings[static_cast<size_t>(i)].noalias() = residual.J_cam.transpose() * J_point;
  }
  hessian.diagonal() *= 1.0 + damping;
  system.points[track] = {hessian.inverse(), gradient};
  return problem.keypoint_loss2 * std::log(product) +
         problem.inverse_distance_information * x.inverse_distance * x.inverse_distance;
}

// H_cc -= W_c V^-1 W_c'^T,  g_c -= W_c V^-1 g_point.
void EliminatePoint(const RigAdjustment& problem, size_t track, ReducedSystem& system) {
  const ReducedSystem::Point& point = system.points[track];
  const int end = problem.begins[track + 1];
  for (int i = problem.begins[track]; i < end; ++i) {
    const Eigen::Index a = Unknown(problem.observations[static_cast<size_t>(i)].camera);
    if (a < 0) continue;
    const Matrix63 scaled = system.couplings[static_cast<size_t>(i)] * point.inverse_hessian;
    system.gradient.segment<6>(a).noalias() -= scaled * point.gradient;
    // Cameras ascend within a track: only blocks below the diagonal.
    for (int j = problem.begins[track]; j <= i; ++j) {
      const Eigen::Index b = Unknown(problem.observations[static_cast<size_t>(j)].camera);
      if (b < 0) continue;
      system.hessian.block<6, 6>(a, b).noalias() -=
          scaled * system.couplings[static_cast<size_t>(j)].transpose();
    }
  }
}

Matrix6d Whitening(const Matrix6d& covariance) {
  const Eigen::LLT<Matrix6d> llt(covariance);
  return llt.matrixL().solve(Matrix6d::Identity());
}

// Motions of a rig, its cameras numbered from first_camera on.
void AppendMotions(const RefinedRig& rig, int first_camera, RigAdjustment& problem) {
  for (const RigMotion& motion : rig.motions) {
    problem.motions.push_back({first_camera + motion.from, first_camera + motion.to,
                               rig.T_rig_cam[static_cast<size_t>(motion.from)].inverse() *
                                   rig.T_rig_cam[static_cast<size_t>(motion.to)],
                               Whitening(motion.covariance)});
  }
}

BearingMeasurement Measure(const TrackObservation& observation, double focal_px, double sigma_px) {
  return {observation.camera, observation.bearing,
          focal_px / sigma_px * TangentBasis(observation.bearing)};
}

}  // namespace

RigAdjustment MakeAdjustment(const RefinedRig& cand,
                             const RefinedRig& query,
                             const RigTracks& tracks,
                             const RigRefinementOptions& options) {
  const size_t num_cand = cand.T_rig_cam.size();
  RigAdjustment problem;
  problem.num_cameras = static_cast<int>(num_cand + query.T_rig_cam.size());
  AppendMotions(cand, 0, problem);
  AppendMotions(query, static_cast<int>(num_cand), problem);
  problem.begins = tracks.begins;
  problem.observations.reserve(tracks.observations.size());
  for (const TrackObservation& observation : tracks.observations) {
    const size_t c = static_cast<size_t>(observation.camera);
    if (observation.camera < 0 || observation.camera >= problem.num_cameras) {
      throw std::invalid_argument("RefineRigs: a track names a camera that the rigs do not have");
    }
    const double focal_px = c < num_cand ? cand.focal_px[c] : query.focal_px[c - num_cand];
    problem.observations.push_back(Measure(observation, focal_px, options.sigma_px));
  }
  problem.keypoint_loss2 = options.keypoint_loss * options.keypoint_loss;
  problem.motion_loss2 = options.motion_dof + 6.0;
  problem.inverse_distance_information =
      1.0 / (options.max_inverse_distance_per_m * options.max_inverse_distance_per_m);
  return problem;
}

std::vector<Eigen::Isometry3d> CamerasInWorld(const std::vector<Eigen::Isometry3d>& T_cand_cam,
                                              const std::vector<Eigen::Isometry3d>& T_query_cam,
                                              const Eigen::Isometry3d& T_cand_query) {
  const Eigen::Isometry3d T_world_cand = T_cand_cam[0].inverse();
  std::vector<Eigen::Isometry3d> T_world_cam;
  for (const Eigen::Isometry3d& T : T_cand_cam) T_world_cam.push_back(T_world_cand * T);
  T_world_cam[0].setIdentity();
  for (const Eigen::Isometry3d& T : T_query_cam) {
    T_world_cam.push_back(T_world_cand * T_cand_query * T);
  }
  return T_world_cam;
}

RobustLoss CauchyLoss(double squared_error, double loss2) {
  const double ratio = 1.0 + squared_error / loss2;
  return {loss2 * std::log(ratio), 1.0 / ratio};
}

RobustLoss MotionLoss(double squared_error, const RigRefinementOptions& options) {
  return CauchyLoss(squared_error, options.motion_dof + 6.0);
}

MotionResidual EvaluateMotion(const AdjustedMotion& motion, const RigAdjustmentState& state) {
  const Eigen::Isometry3d& from = state.T_world_cam[static_cast<size_t>(motion.from)];
  const Eigen::Isometry3d& to = state.T_world_cam[static_cast<size_t>(motion.to)];
  const RelativePoseResidual residual = EvaluateRelativePose(
      Eigen::Quaterniond(Eigen::Matrix3d(from.linear())), from.translation(),
      Eigen::Quaterniond(Eigen::Matrix3d(to.linear())), to.translation(), motion.T_from_to);
  return {motion.whitening * residual.error, motion.whitening * residual.J_from,
          motion.whitening * residual.J_to};
}

double Linearize(const RigAdjustment& problem,
                 const RigAdjustmentState& state,
                 double damping,
                 ReducedSystem& system) {
  const Eigen::Index n = problem.NumCameraUnknowns();
  system.hessian.setZero(n, n);
  system.gradient.setZero(n);
  system.points.resize(problem.NumTracks());
  system.couplings.resize(problem.observations.size());
  double cost = AddMotions(problem, state, system);
  for (size_t t = 0; t < problem.NumTracks(); ++t) {
    cost += AddObservations(problem, state, t, damping, system);
    EliminatePoint(problem, t, system);
  }
  system.hessian.triangularView<Eigen::StrictlyUpper>() =
      system.hessian.transpose().triangularView<Eigen::StrictlyUpper>();
  return cost;
}

RigAdjustmentState Step(const RigAdjustment& problem,
                        const RigAdjustmentState& state,
                        const ReducedSystem& system) {
  const Eigen::VectorXd delta = -system.hessian.ldlt().solve(system.gradient);
  RigAdjustmentState next = state;
  for (int c = 1; c < problem.num_cameras; ++c) {
    Eigen::Isometry3d& T = next.T_world_cam[static_cast<size_t>(c)];
    T = T * ExpSE3(delta.segment<6>(Unknown(c)));
  }
  for (size_t t = 0; t < problem.NumTracks(); ++t) {
    Eigen::Vector3d gradient = system.points[t].gradient;
    for (int i = problem.begins[t]; i < problem.begins[t + 1]; ++i) {
      const Eigen::Index c = Unknown(problem.observations[static_cast<size_t>(i)].camera);
      if (c < 0) continue;
      gradient.noalias() +=
          system.couplings[static_cast<size_t>(i)].transpose() * delta.segment<6>(c);
    }
    next.points[t] = Perturb(state.points[t], -system.points[t].inverse_hessian * gradient);
  }
  return next;
}

}  // namespace covinz
