// Levenberg-Marquardt over the cameras of two rigs and the points of their tracks.
#include "covinz/rig_refinement.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include <Eigen/Cholesky>

#include "covinz/triangulation.h"
#include "rig_adjustment.h"

namespace covinz {
namespace {

std::vector<InverseDistancePoint> Triangulate(const RigAdjustment& problem,
                                              const std::vector<Eigen::Isometry3d>& T_world_cam) {
  std::vector<InverseDistancePoint> points;
  points.reserve(problem.NumTracks());
  const BearingMeasurement* observations = problem.observations.data();
  for (size_t t = 0; t < problem.NumTracks(); ++t) {
    points.push_back(TriangulateTrack(observations + problem.begins[t],
                                      observations + problem.begins[t + 1], T_world_cam,
                                      problem.inverse_distance_information));
  }
  return points;
}

// Minimises from the given state, which becomes the result; returns the number of iterations. The
// cost of a step comes with the equations of the next one.
int Minimize(const RigAdjustment& problem,
             const RigRefinementOptions& options,
             RigAdjustmentState& state,
             double& cost) {
  double damping = 1e-4;
  ReducedSystem system, next_system;
  cost = Linearize(problem, state, damping, system);
  int iteration = 0;
  // Lowered right after it had to be raised, the damping would have to be raised again.
  bool raised = false;
  while (iteration < options.max_num_iterations) {
    ++iteration;
    RigAdjustmentState next = Step(problem, state, system);
    const double lower_damping = raised ? damping : std::max(1e-8, 0.1 * damping);
    const double next_cost = Linearize(problem, next, lower_damping, next_system);
    if (!(next_cost < cost)) {
      if (!(damping < 1e3)) break;
      damping *= 10.0;
      raised = true;
      Linearize(problem, state, damping, system);
      continue;
    }
    const double decrease = cost - next_cost;
    state = std::move(next);
    std::swap(system, next_system);
    cost = next_cost;
    damping = lower_damping;
    raised = false;
    if (decrease < options.min_relative_decrease * cost) break;
  }
  return iteration;
}

void MarkInliers(const RigAdjustment& problem,
                 const RigAdjustmentState& state,
                 const RigRefinementOptions& options,
                 RigRefinement& result) {
  const double max_error2 = std::pow(options.max_error_px / options.sigma_px, 2);
  result.num_inlier_tracks = 0;
  for (size_t t = 0; t < problem.NumTracks(); ++t) {
    bool all = true;
    for (int i = problem.begins[t]; i < problem.begins[t + 1]; ++i) {
      const BearingMeasurement& measured = problem.observations[static_cast<size_t>(i)];
      const Eigen::Vector3d unit =
          RayInCamera(state.points[t], state.T_world_cam[static_cast<size_t>(measured.camera)])
              .normalized();
      const bool inlier = measured.bearing.dot(unit) > 0.0 &&
                          (measured.whitened_basis * unit).squaredNorm() <= max_error2;
      result.inliers.push_back(inlier);
      all = all && inlier;
    }
    if (all) ++result.num_inlier_tracks;
  }
}

// From the world (the candidate's first camera) back to the rigs' bodies.
void ExportPoses(const RefinedRig& cand,
                 const RefinedRig& query,
                 const RigAdjustmentState& state,
                 RigRefinement& result) {
  const size_t num_cand = cand.T_rig_cam.size();
  const Eigen::Isometry3d T_query_world =
      query.T_rig_cam[0] * state.T_world_cam[num_cand].inverse();
  result.T_cand_query = cand.T_rig_cam[0] * T_query_world.inverse();
  for (size_t c = 0; c < state.T_world_cam.size(); ++c) {
    if (c < num_cand) {
      result.T_cand_cam.push_back(cand.T_rig_cam[0] * state.T_world_cam[c]);
    } else {
      result.T_query_cam.push_back(T_query_world * state.T_world_cam[c]);
    }
  }
}

}  // namespace

void RefinedRig::Check() const {
  const int num_cameras = static_cast<int>(T_rig_cam.size());
  if (num_cameras == 0) throw std::invalid_argument("RefinedRig: a rig needs a camera");
  if (focal_px.size() != T_rig_cam.size()) {
    throw std::invalid_argument("RefinedRig: one focal length for each camera");
  }
  for (size_t c = 0; c < T_rig_cam.size(); ++c) {
    if (!T_rig_cam[c].matrix().allFinite() || !(focal_px[c] > 0.0 && std::isfinite(focal_px[c]))) {
      throw std::invalid_argument("RefinedRig: poses and focal lengths must be finite");
    }
  }
  std::vector<bool> tied(T_rig_cam.size(), false);
  tied[0] = true;
  for (const RigMotion& motion : motions) {
    if (motion.from < 0 || motion.from >= num_cameras || motion.to < 0 ||
        motion.to >= num_cameras || motion.from == motion.to) {
      throw std::invalid_argument("RefinedRig: a motion names cameras that the rig does not have");
    }
    if (!motion.covariance.allFinite() ||
        !motion.covariance.isApprox(motion.covariance.transpose(), 1e-6) ||
        Eigen::LLT<Matrix6d>(motion.covariance).info() != Eigen::Success) {
      throw std::invalid_argument("RefinedRig: covariances must be symmetric, positive definite");
    }
  }
  for (size_t round = 0; round < motions.size(); ++round) {
    for (const RigMotion& motion : motions) {
      const size_t from = static_cast<size_t>(motion.from);
      const size_t to = static_cast<size_t>(motion.to);
      tied[from] = tied[to] = tied[from] || tied[to];
    }
  }
  if (std::find(tied.begin(), tied.end(), false) != tied.end()) {
    throw std::invalid_argument("RefinedRig: motions must tie every camera to the first");
  }
}

void RigRefinementOptions::Check() const {
  if (!(sigma_px > 0.0 && keypoint_loss > 0.0 && motion_dof > 0.0 && max_error_px > 0.0 &&
        max_inverse_distance_per_m > 0.0)) {
    throw std::invalid_argument("RigRefinementOptions: sigmas, losses and limits must be positive");
  }
  if (!IsSupported(instruction_set)) {
    throw std::invalid_argument("RigRefinementOptions: this processor lacks the instruction set");
  }
  if (max_num_iterations < 0 || !(min_relative_decrease >= 0.0)) {
    throw std::invalid_argument("RigRefinementOptions: iterations and decrease must be >= 0");
  }
}

RigRefinement RefineRigs(const RefinedRig& cand,
                         const RefinedRig& query,
                         const RigTracks& tracks,
                         const RigPoses& start,
                         const RigRefinementOptions& options) {
  options.Check();
  cand.Check();
  query.Check();
  if (start.T_cand_cam.size() != cand.T_rig_cam.size() ||
      start.T_query_cam.size() != query.T_rig_cam.size()) {
    throw std::invalid_argument("RefineRigs: a start must have the cameras of the rigs");
  }
  RigAdjustment problem = MakeAdjustment(cand, query, tracks, options);
  problem.blocks = BlockTracks(problem);
  RigAdjustmentState state;
  state.T_world_cam = CamerasInWorld(start.T_cand_cam, start.T_query_cam, start.T_cand_query);
  state.points = Triangulate(problem, state.T_world_cam);
  RigRefinement result;
  result.num_iterations = Minimize(problem, options, state, result.cost);
  ExportPoses(cand, query, state, result);
  MarkInliers(problem, state, options, result);
  for (const AdjustedMotion& motion : problem.motions) {
    result.motion_residuals.push_back(EvaluateMotion(motion, state).error);
  }
  result.points = std::move(state.points);
  return result;
}

RigRefinement RefineRigs(const RefinedRig& cand,
                         const RefinedRig& query,
                         const RigTracks& tracks,
                         const Eigen::Isometry3d& T_cand_query,
                         const RigRefinementOptions& options) {
  return RefineRigs(cand, query, tracks, {cand.T_rig_cam, query.T_rig_cam, T_cand_query}, options);
}

}  // namespace covinz
