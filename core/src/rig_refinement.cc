// Levenberg-Marquardt over the cameras of two rigs and the points of their tracks.
#include "covinz/rig_refinement.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include <Eigen/Cholesky>

#include "covinz/triangulation.h"
#include "rig_adjustment.h"
#include "rig_covariance.h"

namespace covinz {
namespace {

Matrix6d Whitening(const Matrix6d& covariance) {
  const Eigen::LLT<Matrix6d> llt(covariance);
  return llt.matrixL().solve(Matrix6d::Identity());
}

// Motions of a rig, its cameras numbered from first_camera on.
void AddMotions(const RefinedRig& rig, int first_camera, RigAdjustment& problem) {
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

RigAdjustment MakeProblem(const RefinedRig& cand,
                          const RefinedRig& query,
                          const RigTracks& tracks,
                          const RigRefinementOptions& options) {
  const size_t num_cand = cand.T_rig_cam.size();
  RigAdjustment problem;
  problem.num_cameras = static_cast<int>(num_cand + query.T_rig_cam.size());
  AddMotions(cand, 0, problem);
  AddMotions(query, static_cast<int>(num_cand), problem);
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

RigAdjustmentState InitialState(const RigAdjustment& problem,
                                const RefinedRig& cand,
                                const RefinedRig& query,
                                const Eigen::Isometry3d& T_cand_query) {
  RigAdjustmentState state;
  const Eigen::Isometry3d T_world_cand = cand.T_rig_cam[0].inverse();
  for (const Eigen::Isometry3d& T : cand.T_rig_cam) state.T_world_cam.push_back(T_world_cand * T);
  state.T_world_cam[0].setIdentity();
  for (const Eigen::Isometry3d& T : query.T_rig_cam) {
    state.T_world_cam.push_back(T_world_cand * T_cand_query * T);
  }
  const BearingMeasurement* observations = problem.observations.data();
  for (size_t t = 0; t < problem.NumTracks(); ++t) {
    state.points.push_back(TriangulateTrack(observations + problem.begins[t],
                                            observations + problem.begins[t + 1], state.T_world_cam,
                                            problem.inverse_distance_information));
  }
  return state;
}

// Minimises from the given state, which becomes the result; returns the number of iterations.
int Minimize(const RigAdjustment& problem,
             const RigRefinementOptions& options,
             RigAdjustmentState& state,
             double& cost) {
  double damping = 1e-4;
  ReducedSystem system;
  cost = Cost(problem, state);
  int iteration = 0;
  while (iteration < options.max_num_iterations) {
    ++iteration;
    Linearize(problem, state, damping, system);
    RigAdjustmentState next = Step(problem, state, system);
    const double next_cost = Cost(problem, next);
    if (!(next_cost < cost)) {
      if (!(damping < 1e3)) break;
      damping *= 10.0;
      continue;
    }
    const double decrease = cost - next_cost;
    state = std::move(next);
    cost = next_cost;
    damping = std::max(1e-8, 0.1 * damping);
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
  if (max_num_iterations < 0 || !(min_relative_decrease >= 0.0)) {
    throw std::invalid_argument("RigRefinementOptions: iterations and decrease must be >= 0");
  }
}

RigRefinement RefineRigs(const RefinedRig& cand,
                         const RefinedRig& query,
                         const RigTracks& tracks,
                         const Eigen::Isometry3d& T_cand_query,
                         const RigRefinementOptions& options) {
  options.Check();
  cand.Check();
  query.Check();
  const RigAdjustment problem = MakeProblem(cand, query, tracks, options);
  RigAdjustmentState state = InitialState(problem, cand, query, T_cand_query);
  RigRefinement result;
  result.num_iterations = Minimize(problem, options, state, result.cost);
  ExportPoses(cand, query, state, result);
  MarkInliers(problem, state, options, result);
  for (const AdjustedMotion& motion : problem.motions) {
    result.motion_residuals.push_back(EvaluateMotion(motion, state).error);
  }
  const AdjustmentCovariance covariance = EstimateCovariance(problem, state);
  const Eigen::Index q = 6 * (static_cast<Eigen::Index>(cand.T_rig_cam.size()) - 1);
  // From the query's first camera to its body.
  const Matrix6d Ad = AdjointSE3(query.T_rig_cam[0]);
  result.covariance = Ad * covariance.cameras.block<6, 6>(q, q) * Ad.transpose();
  result.residuals = covariance.residuals;
  return result;
}

}  // namespace covinz
