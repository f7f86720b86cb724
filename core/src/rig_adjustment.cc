// Cost, normal equations with the points eliminated, and steps of the rig refinement.
#include "rig_adjustment.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>

#include <Eigen/Cholesky>

#include "covinz/pose_graph_residual.h"

namespace covinz {
namespace {

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

// Of the lanes of all blocks: direction and inverse distance.
std::vector<double> PackPoints(const RigAdjustment& problem, const RigAdjustmentState& state) {
  const TrackBlocks& blocks = problem.blocks;
  std::vector<double> packed(4 * blocks.tracks.size());
  for (size_t i = 0; i < blocks.tracks.size(); ++i) {
    double* lane = &packed[i / kTrackLanes * 4 * kTrackLanes + i % kTrackLanes];
    const bool empty = blocks.tracks[i] < 0;
    const InverseDistancePoint point = empty ? InverseDistancePoint{Eigen::Vector3d::UnitZ(), 0.0}
                                             : state.points[static_cast<size_t>(blocks.tracks[i])];
    for (int k = 0; k < 3; ++k) lane[static_cast<size_t>(k) * kTrackLanes] = point.direction[k];
    lane[3 * kTrackLanes] = point.inverse_distance;
  }
  return packed;
}

std::vector<AdjustmentPose> PackPoses(const RigAdjustmentState& state) {
  std::vector<AdjustmentPose> poses;
  for (const Eigen::Isometry3d& T : state.T_world_cam) {
    AdjustmentPose pose;
    Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(pose.R) = T.linear();
    Eigen::Map<Eigen::Vector3d>(pose.t) = T.translation();
    poses.push_back(pose);
  }
  return poses;
}

// Adds the kernels' sums over lanes; of the diagonal blocks the lower triangle, of the others those
// below the diagonal.
void AddSums(const double* hessian_lanes, const double* gradient_lanes, ReducedSystem& system) {
  const Eigen::Index num_cameras = system.gradient.size() / 6;
  for (Eigen::Index a = 0; a < num_cameras; ++a) {
    for (Eigen::Index b = 0; b <= a; ++b) {
      for (Eigen::Index i = 0; i < 6; ++i) {
        for (Eigen::Index j = 0; j < 6; ++j, hessian_lanes += kTrackLanes) {
          if (a > b || i >= j) system.hessian(6 * a + i, 6 * b + j) += SumLanes(hessian_lanes);
        }
      }
    }
  }
  for (Eigen::Index i = 0; i < system.gradient.size(); ++i, gradient_lanes += kTrackLanes) {
    system.gradient[i] += SumLanes(gradient_lanes);
  }
}

// Tracks with an observation, those of the same cameras side by side, otherwise in their order.
std::vector<int> OrderByCameras(const RigAdjustment& problem) {
  std::vector<uint64_t> cameras(problem.NumTracks(), 0);
  std::vector<int> order;
  for (size_t t = 0; t < problem.NumTracks(); ++t) {
    for (int i = problem.begins[t]; i < problem.begins[t + 1]; ++i) {
      const int camera = problem.observations[static_cast<size_t>(i)].camera;
      cameras[t] |= uint64_t{1} << std::min(camera, 63);
    }
    order.push_back(static_cast<int>(t));
  }
  std::stable_sort(order.begin(), order.end(), [&cameras](int a, int b) {
    return cameras[static_cast<size_t>(a)] < cameras[static_cast<size_t>(b)];
  });
  return order;
}

void FillLane(const BearingMeasurement& measured, size_t lane, AdjustmentView& view) {
  for (int k = 0; k < 3; ++k) {
    const size_t at = static_cast<size_t>(k) * kTrackLanes + lane;
    view.bearing[at] = measured.bearing[k];
    view.whitened_basis[at] = measured.whitened_basis(0, k);
    view.whitened_basis[3 * kTrackLanes + at] = measured.whitened_basis(1, k);
  }
}

// Appends the views of the block of tracks[first] on.
void AppendViews(const RigAdjustment& problem, size_t first, TrackBlocks& blocks) {
  std::vector<int> view_of_camera(static_cast<size_t>(problem.num_cameras), -1);
  const auto for_each = [&](const auto& take) {
    for (size_t lane = 0; lane < kTrackLanes; ++lane) {
      if (blocks.tracks[first + lane] < 0) continue;
      const size_t t = static_cast<size_t>(blocks.tracks[first + lane]);
      for (int i = problem.begins[t]; i < problem.begins[t + 1]; ++i) {
        const BearingMeasurement& measured = problem.observations[static_cast<size_t>(i)];
        take(lane, measured, view_of_camera[static_cast<size_t>(measured.camera)]);
      }
    }
  };
  for_each([](size_t, const BearingMeasurement&, int& view) { view = 0; });
  for (size_t c = 0; c < view_of_camera.size(); ++c) {
    if (view_of_camera[c] < 0) continue;
    view_of_camera[c] = static_cast<int>(blocks.views.size());
    blocks.views.push_back({static_cast<int>(c), {}, {}});
  }
  for_each([&blocks](size_t lane, const BearingMeasurement& measured, int& view) {
    FillLane(measured, lane, blocks.views[static_cast<size_t>(view)]);
  });
  blocks.begins.push_back(blocks.views.size());
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

// The steps of the points of a block for those of the cameras: -V^-1 (g + sum_a W_a^T delta_a).
std::array<Eigen::Vector3d, kTrackLanes> PointSteps(const RigAdjustment& problem,
                                                    const ReducedSystem& system,
                                                    const Eigen::VectorXd& delta,
                                                    size_t block) {
  using Lanes = Eigen::Array<double, kTrackLanes, 1>;
  using Lanes3 = Eigen::Array<double, kTrackLanes, 3>;
  Lanes3 g = Eigen::Map<const Lanes3>(system.points[block].g);
  for (size_t v = problem.blocks.begins[block]; v < problem.blocks.begins[block + 1]; ++v) {
    const Eigen::Index c = Unknown(problem.blocks.views[v].camera);
    if (c < 0) continue;
    for (Eigen::Index i = 0; i < 6; ++i) {
      g += delta[c + i] * Eigen::Map<const Lanes3>(system.couplings[v].W +
                                                   3 * static_cast<size_t>(i) * kTrackLanes);
    }
  }
  const Eigen::Map<const Eigen::Array<double, kTrackLanes, 6>> inverse(
      system.points[block].inverse_V);
  const Lanes x = inverse.col(0) * g.col(0) + inverse.col(1) * g.col(1) + inverse.col(2) * g.col(2);
  const Lanes y = inverse.col(1) * g.col(0) + inverse.col(3) * g.col(1) + inverse.col(4) * g.col(2);
  const Lanes z = inverse.col(2) * g.col(0) + inverse.col(4) * g.col(1) + inverse.col(5) * g.col(2);
  std::array<Eigen::Vector3d, kTrackLanes> steps;
  for (Eigen::Index lane = 0; lane < Eigen::Index{kTrackLanes}; ++lane) {
    steps[static_cast<size_t>(lane)] = -Eigen::Vector3d(x[lane], y[lane], z[lane]);
  }
  return steps;
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
  problem.instruction_set = options.instruction_set;
  problem.keypoint_loss2 = options.keypoint_loss * options.keypoint_loss;
  problem.motion_loss2 = options.motion_dof + 6.0;
  problem.inverse_distance_information =
      1.0 / (options.max_inverse_distance_per_m * options.max_inverse_distance_per_m);
  return problem;
}

TrackBlocks BlockTracks(const RigAdjustment& problem) {
  TrackBlocks blocks;
  blocks.tracks = OrderByCameras(problem);
  blocks.tracks.resize((blocks.tracks.size() + kTrackLanes - 1) / kTrackLanes * kTrackLanes, -1);
  for (size_t first = 0; first < blocks.tracks.size(); first += kTrackLanes) {
    AppendViews(problem, first, blocks);
  }
  return blocks;
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
  const TrackBlocks& blocks = problem.blocks;
  system.hessian.setZero(n, n);
  system.gradient.setZero(n);
  system.points.resize(blocks.size());
  system.couplings.resize(blocks.views.size());
  const size_t num_free = static_cast<size_t>(problem.num_cameras) - 1;
  const size_t hessian_size = 36 * (num_free * (num_free + 1) / 2) * kTrackLanes;
  system.lane_sums.assign(hessian_size + 6 * num_free * kTrackLanes, 0.0);
  const std::vector<AdjustmentPose> poses = PackPoses(state);
  const std::vector<double> points = PackPoints(problem, state);
  AdjustmentTask task;
  task.poses = poses.data();
  task.views = blocks.views.data();
  task.begins = blocks.begins.data();
  task.num_blocks = blocks.size();
  task.points = points.data();
  task.keypoint_loss2 = problem.keypoint_loss2;
  task.direction_information = RigAdjustment::kDirectionInformation;
  task.inverse_distance_information = problem.inverse_distance_information;
  task.damping = damping;
  double* gradient = system.lane_sums.data() + hessian_size;
  double cost = AddMotions(problem, state, system);
  cost += LinearizeTracks(
      problem.instruction_set, task,
      {system.lane_sums.data(), gradient, system.points.data(), system.couplings.data()});
  AddSums(system.lane_sums.data(), gradient, system);
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
    // Rounding adds up over iterations and rounds, and inverses are taken by transposing.
    T.linear() = Eigen::Quaterniond(Eigen::Matrix3d(T.linear())).normalized().toRotationMatrix();
  }
  for (size_t block = 0; block < problem.blocks.size(); ++block) {
    const std::array<Eigen::Vector3d, kTrackLanes> steps =
        PointSteps(problem, system, delta, block);
    for (size_t lane = 0; lane < kTrackLanes; ++lane) {
      const int track = problem.blocks.tracks[block * kTrackLanes + lane];
      if (track < 0) continue;
      const size_t t = static_cast<size_t>(track);
      next.points[t] = Perturb(state.points[t], steps[lane]);
    }
  }
  return next;
}

}  // namespace covinz
