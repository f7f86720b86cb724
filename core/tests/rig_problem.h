// Generated loop problems with ground truth: two rigs that look at the same points.
#pragma once

#include <optional>
#include <random>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/rig_relative_pose.h"

namespace covinz {

// Normal draws for tests only; their values differ between standard libraries.
inline Eigen::Vector3d RandomNormal3(std::mt19937_64& engine, double sigma) {
  std::normal_distribution<double> normal(0.0, 1.0);
  const double x = normal(engine);
  const double y = normal(engine);
  const double z = normal(engine);
  return sigma * Eigen::Vector3d(x, y, z);
}

inline Eigen::Isometry3d RandomPose(std::mt19937_64& engine,
                                    double rotation_rad,
                                    double distance_m) {
  Vector6d xi;
  xi << rotation_rad * RandomNormal3(engine, 1.0).normalized(),
      distance_m * RandomNormal3(engine, 1.0).normalized();
  return ExpSE3(xi);
}

// Defaults are an ordinary loop of a hand-held camera: 640 x 480, f = 500 px.
struct RigProblemOptions {
  int num_query_cams = 2;
  int num_cand_cams = 3;
  int num_points = 150;
  double focal_px = 500.0;
  double noise_px = 0.0;
  double outlier_ratio = 0.0;
  // Between neighbouring keyframes of a rig; 0 is a rig that only turns.
  double baseline_m = 0.2;
  double turn_rad = 0.1;
  // Keyframes of a rig on one line, as a robot that drives straight.
  bool straight = false;
  // Error of the odometry between them, per axis.
  double odometry_noise_m = 0.0;
  double odometry_noise_rad = 0.0;
  double loop_distance_m = 0.5;
  double loop_turn_rad = 0.3;
  double min_depth_m = 2.0;
  double max_depth_m = 6.0;
  uint64_t seed = 0;
  // Instead of a random one; everything else stays as the seed has it.
  std::optional<Eigen::Isometry3d> T_cand_query = std::nullopt;
};

struct RigProblem {
  RigPairs rigs;                    // as odometry and matching would give them
  Eigen::Isometry3d T_cand_query;   // ground truth
  Eigen::Isometry3d T_cand_points;  // of the points below
  std::vector<Eigen::Vector3d> points;
};

inline std::vector<Eigen::Isometry3d> MakeRig(int num_cams,
                                              const RigProblemOptions& options,
                                              std::mt19937_64& engine) {
  const Eigen::Vector3d heading = RandomNormal3(engine, 1.0).normalized();
  std::vector<Eigen::Isometry3d> T_rig_cam{Eigen::Isometry3d::Identity()};
  for (int i = 1; i < num_cams; ++i) {
    T_rig_cam.push_back(T_rig_cam.back() *
                        RandomPose(engine, options.turn_rad, options.baseline_m));
    if (options.straight) T_rig_cam.back().translation() = i * options.baseline_m * heading;
  }
  return T_rig_cam;
}

// What odometry makes of the rig: the same error whatever the length of the step.
inline std::vector<Eigen::Isometry3d> AddOdometryNoise(const std::vector<Eigen::Isometry3d>& rig,
                                                       const RigProblemOptions& options,
                                                       std::mt19937_64& engine) {
  std::vector<Eigen::Isometry3d> noisy{rig[0]};
  for (size_t i = 1; i < rig.size(); ++i) {
    Vector6d xi;
    xi << RandomNormal3(engine, options.odometry_noise_rad),
        RandomNormal3(engine, options.odometry_noise_m);
    noisy.push_back(noisy.back() * rig[i - 1].inverse() * rig[i] * ExpSE3(xi));
  }
  return noisy;
}

// One keypoint a camera and point, so that its noise is shared by all pairs it takes part in.
inline std::vector<Eigen::Vector3d> Observe(const std::vector<Eigen::Vector3d>& points_rig,
                                            const Eigen::Isometry3d& T_rig_cam,
                                            const RigProblemOptions& options,
                                            std::mt19937_64& engine) {
  std::vector<Eigen::Vector3d> bearings;
  for (const Eigen::Vector3d& point_rig : points_rig) {
    const Eigen::Vector3d point_cam = T_rig_cam.inverse() * point_rig;
    const Eigen::Vector3d noise = RandomNormal3(engine, options.noise_px / options.focal_px);
    const Eigen::Vector3d bearing = point_cam.normalized();
    bearings.push_back((bearing + noise - bearing * bearing.dot(noise)).normalized());
  }
  return bearings;
}

inline BearingPairs MakePairs(const std::vector<Eigen::Vector3d>& query,
                              const std::vector<Eigen::Vector3d>& cand,
                              const RigProblemOptions& options,
                              std::mt19937_64& engine) {
  BearingPairs pairs;
  pairs.query_focal_px = options.focal_px;
  pairs.cand_focal_px = options.focal_px;
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::uniform_int_distribution<size_t> any(0, cand.size() - 1);
  for (size_t i = 0; i < query.size(); ++i) {
    pairs.query.push_back(query[i]);
    pairs.cand.push_back(uniform(engine) < options.outlier_ratio ? cand[any(engine)] : cand[i]);
  }
  return pairs;
}

inline RigProblem MakeRigProblem(const RigProblemOptions& options) {
  std::mt19937_64 engine(options.seed);
  RigProblem problem;
  problem.T_cand_query = RandomPose(engine, options.loop_turn_rad, options.loop_distance_m);
  if (options.T_cand_query) problem.T_cand_query = *options.T_cand_query;
  const std::vector<Eigen::Isometry3d> query_rig = MakeRig(options.num_query_cams, options, engine);
  const std::vector<Eigen::Isometry3d> cand_rig = MakeRig(options.num_cand_cams, options, engine);
  std::uniform_real_distribution<double> u(-0.64, 0.64), v(-0.48, 0.48),
      depth(options.min_depth_m, options.max_depth_m);
  std::vector<Eigen::Vector3d> points_query;
  for (int i = 0; i < options.num_points; ++i) {
    const double z = depth(engine);
    const double x = u(engine) * z;
    const double y = v(engine) * z;
    problem.points.emplace_back(x, y, z);
    points_query.push_back(problem.T_cand_query.inverse() * problem.points.back());
  }
  std::vector<std::vector<Eigen::Vector3d>> query, cand;
  for (const auto& T : query_rig) query.push_back(Observe(points_query, T, options, engine));
  for (const auto& T : cand_rig) cand.push_back(Observe(problem.points, T, options, engine));
  for (int q = 0; q < options.num_query_cams; ++q) {
    for (int c = 0; c < options.num_cand_cams; ++c) {
      problem.rigs.pairs.push_back(MakePairs(query[size_t(q)], cand[size_t(c)], options, engine));
      problem.rigs.pairs.back().query_cam = q;
      problem.rigs.pairs.back().cand_cam = c;
    }
  }
  problem.rigs.T_query_cam = AddOdometryNoise(query_rig, options, engine);
  problem.rigs.T_cand_cam = AddOdometryNoise(cand_rig, options, engine);
  return problem;
}

// Error of an estimate: [rotation, translation] in the query body frame.
inline Vector6d PoseError(const Eigen::Isometry3d& T_true, const Eigen::Isometry3d& T_estimate) {
  return LogSE3(T_true.inverse() * T_estimate);
}

}  // namespace covinz
