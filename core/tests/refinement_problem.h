// Generated problems of the rig refinement: matches with keypoint rows, odometry with its
// covariance, and the errors of real images (shared by neighbours, heavy tails) on demand.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <random>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/rig_covariance.h"
#include "covinz/rig_refinement.h"
#include "rig_problem.h"

namespace covinz {

// Defaults are the problems of the benchmarks: 752 x 480 px, f = 458 px, 2 + 3 keyframes.
struct RefinementProblemOptions {
  double noise_px = 1.0;
  // Keypoint error that neighbours share: root mean square, and the distance over which it fades.
  double shared_px = 0.0;
  double shared_length_px = 80.0;
  // Relative error of the focal length of all cameras.
  double focal_error = 0.0;
  // Odometry between neighbouring keyframes, per axis, and as the solver is told.
  double odometry_noise_m = 0.01 / std::sqrt(3.0);
  double odometry_noise_rad = 0.2 * M_PI / 180.0 / std::sqrt(3.0);
  double odometry_told = 1.0;  // factor of the sigmas told
  // Every so often a motion is off by so many times its sigmas.
  double odometry_tail_share = 0.0;
  double odometry_tail = 5.0;
  double min_step_m = 0.1;
  double max_step_m = 0.6;
  double turn_rad = 3.0 * M_PI / 180.0;
  double min_loop_m = 0.1;
  double max_loop_m = 1.5;
  double loop_yaw_rad = 25.0 * M_PI / 180.0;
  double min_depth_m = 2.0;
  double max_depth_m = 15.0;
  bool forward = false;
  double num_matches = 900;
  double repeatability = 0.7;
  // Wrong matches among all matches; they are not in the problem's inliers.
  double outlier_share = 0.0;
  uint64_t seed = 0;
};

struct RefinementProblem {
  RigPairs rigs;
  std::vector<std::vector<Match>> keypoints;
  std::vector<std::vector<int>> inliers;  // the true matches
  RefinedRig cand;
  RefinedRig query;
  Eigen::Isometry3d T_cand_query;  // ground truth
  std::vector<Eigen::Isometry3d> T_cand_cam;
  std::vector<Eigen::Isometry3d> T_query_cam;

  RigTracks Tracks(const Eigen::Isometry3d& T) const {
    return MergeTracks(InlierLinks(rigs, keypoints, inliers, T));
  }
};

// A refinement with its covariance.
struct CalibratedRefinement : RigRefinement, RefinementCovariance {};

inline CalibratedRefinement Refine(const RefinementProblem& problem,
                                   const RigTracks& tracks,
                                   const Eigen::Isometry3d& start,
                                   const RigRefinementOptions& options = {}) {
  const RigRefinement refined = RefineRigs(problem.cand, problem.query, tracks, start, options);
  return {refined,
          EstimateRefinementCovariance(problem.cand, problem.query, tracks, refined, options, {})};
}

// From the truth, with tracks of all its inliers.
inline CalibratedRefinement Refine(const RefinementProblem& problem) {
  return Refine(problem, problem.Tracks(problem.T_cand_query), problem.T_cand_query);
}

// A smooth random displacement of an image: a sum of waves of random direction.
class SmoothField {
 public:
  SmoothField(double rms_px, double length_px, std::mt19937_64& engine) {
    std::uniform_real_distribution<double> phase(0.0, 2.0 * M_PI);
    for (Wave& wave : waves_) {
      const Eigen::Vector3d normal = RandomNormal3(engine, 1.0);
      wave.frequency = normal.head<2>() / length_px;
      wave.phase = phase(engine);
      const double angle = phase(engine);
      wave.amplitude = rms_px * std::sqrt(2.0 / waves_.size()) *
                       Eigen::Vector2d(std::cos(angle), std::sin(angle));
      wave.amplitude *= std::sqrt(2.0);
    }
  }
  Eigen::Vector2d operator()(const Eigen::Vector2d& pixel) const {
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    for (const Wave& wave : waves_) {
      sum += wave.amplitude * std::cos(wave.frequency.dot(pixel) + wave.phase);
    }
    return sum;
  }

 private:
  struct Wave {
    Eigen::Vector2d frequency;
    double phase;
    Eigen::Vector2d amplitude;
  };
  std::array<Wave, 24> waves_;
};

class RefinementProblemMaker {
 public:
  explicit RefinementProblemMaker(const RefinementProblemOptions& options)
      : options_(options), engine_(options.seed) {}

  RefinementProblem Make() {
    RefinementProblem problem;
    problem.T_cand_query = Loop();
    MakeRig({{1, 0}}, problem.T_query_cam, problem.query);
    MakeRig({{1, 0}, {0, 2}}, problem.T_cand_cam, problem.cand);
    Observe(problem);
    problem.rigs.T_query_cam = problem.query.T_rig_cam;
    problem.rigs.T_cand_cam = problem.cand.T_rig_cam;
    return problem;
  }

 private:
  double Uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(engine_);
  }

  Eigen::Isometry3d Loop() {
    Vector6d xi;
    xi << RandomNormal3(engine_, 0.03), RandomNormal3(engine_, 1.0);
    xi.y() = Uniform(-options_.loop_yaw_rad, options_.loop_yaw_rad);
    if (options_.forward) xi << RandomNormal3(engine_, 0.03), Eigen::Vector3d::UnitZ();
    xi.tail<3>() *= Uniform(options_.min_loop_m, options_.max_loop_m) / xi.tail<3>().norm();
    return ExpSE3(xi);
  }

  // Cameras are bodies. Motions as pairs of cameras; the first of a pair or the second is known.
  void MakeRig(const std::vector<std::array<int, 2>>& motions,
               std::vector<Eigen::Isometry3d>& truth,
               RefinedRig& rig) {
    const size_t num_cams = motions.size() + 1;
    truth.assign(num_cams, Eigen::Isometry3d::Identity());
    rig.T_rig_cam = truth;
    rig.focal_px.assign(num_cams, kFocal_px);
    Eigen::Vector3d direction = RandomNormal3(engine_, 1.0);
    direction.y() *= 0.2;
    if (options_.forward) direction = Eigen::Vector3d::UnitZ();
    for (const auto& [from, to] : motions) {
      Vector6d xi;
      xi << RandomNormal3(engine_, options_.turn_rad / std::sqrt(3.0)), direction;
      xi.tail<3>() *= Uniform(options_.min_step_m, options_.max_step_m) / direction.norm();
      const Eigen::Isometry3d step = ExpSE3(xi);
      const Eigen::Isometry3d measured = step * OdometryError();
      const size_t f = static_cast<size_t>(from);
      const size_t t = static_cast<size_t>(to);
      if (to == 0) {
        truth[f] = step.inverse();
        rig.T_rig_cam[f] = measured.inverse();
      } else {
        truth[t] = truth[f] * step;
        rig.T_rig_cam[t] = rig.T_rig_cam[f] * measured;
      }
      Vector6d variances;
      variances << Eigen::Vector3d::Constant(std::pow(options_.odometry_noise_rad, 2)),
          Eigen::Vector3d::Constant(std::pow(options_.odometry_noise_m, 2));
      variances = variances.cwiseMax(1e-12) * std::pow(options_.odometry_told, 2);
      rig.motions.push_back({from, to, variances.asDiagonal()});
    }
  }

  Eigen::Isometry3d OdometryError() {
    Vector6d xi;
    xi << RandomNormal3(engine_, options_.odometry_noise_rad),
        RandomNormal3(engine_, options_.odometry_noise_m);
    if (Uniform(0.0, 1.0) < options_.odometry_tail_share) xi *= options_.odometry_tail;
    return ExpSE3(xi);
  }

  // Points until there are matches enough; a camera sees a point within its image, not always.
  void Observe(RefinementProblem& problem) {
    std::vector<Eigen::Isometry3d> T_cam_cand;  // query's first
    for (const auto& T : problem.T_query_cam) {
      T_cam_cand.push_back((problem.T_cand_query * T).inverse());
    }
    for (const auto& T : problem.T_cand_cam) T_cam_cand.push_back(T.inverse());
    std::vector<SmoothField> fields;
    for (size_t c = 0; c < T_cam_cand.size(); ++c) {
      fields.emplace_back(options_.shared_px, options_.shared_length_px, engine_);
    }
    for (int q = 0; q < 2; ++q) {
      for (int c = 0; c < 3; ++c) {
        BearingPairs pairs;
        pairs.query_cam = q;
        pairs.cand_cam = c;
        pairs.query_focal_px = pairs.cand_focal_px = kFocal_px;
        problem.rigs.pairs.push_back(pairs);
      }
    }
    problem.keypoints.resize(6);
    problem.inliers.resize(6);
    std::array<int, 5> rows{};
    int num_matches = 0;
    for (int tries = 0; num_matches < options_.num_matches && tries < 100000; ++tries) {
      const double z = Uniform(options_.min_depth_m, options_.max_depth_m);
      const Eigen::Vector3d point(Uniform(-376, 376) / kFocal_px * z,
                                  Uniform(-240, 240) / kFocal_px * z, z);
      std::array<std::optional<Eigen::Vector3d>, 5> seen;
      for (size_t c = 0; c < 5; ++c) seen[c] = See(T_cam_cand[c] * point, fields[c]);
      num_matches += AddMatches(seen, rows, problem);
    }
    AddWrongMatches(rows, problem);
  }

  // Keypoints of their own, anywhere in both images.
  void AddWrongMatches(std::array<int, 5>& rows, RefinementProblem& problem) {
    const double share = options_.outlier_share;
    const auto anywhere = [this] {
      return Eigen::Vector3d(Uniform(-376, 376), Uniform(-240, 240), kFocal_px).normalized();
    };
    for (size_t p = 0; p < 6; ++p) {
      BearingPairs& pairs = problem.rigs.pairs[p];
      const int num_wrong = int(share / (1.0 - share) * double(pairs.size()));
      for (int i = 0; i < num_wrong; ++i) {
        problem.keypoints[p].push_back({rows[p / 3]++, rows[2 + p % 3]++});
        pairs.query.push_back(anywhere());
        pairs.cand.push_back(anywhere());
      }
    }
  }

  std::optional<Eigen::Vector3d> See(const Eigen::Vector3d& point_cam, const SmoothField& field) {
    const Eigen::Vector3d noise = RandomNormal3(engine_, options_.noise_px);
    if (Uniform(0.0, 1.0) > options_.repeatability || point_cam.z() < 0.1) return std::nullopt;
    Eigen::Vector2d pixel = kFocal_px * point_cam.head<2>() / point_cam.z();
    if (std::abs(pixel.x()) > 376.0 || std::abs(pixel.y()) > 240.0) return std::nullopt;
    pixel = (1.0 + options_.focal_error) * pixel + field(pixel) + noise.head<2>();
    return Eigen::Vector3d(pixel.x() / kFocal_px, pixel.y() / kFocal_px, 1.0).normalized();
  }

  int AddMatches(const std::array<std::optional<Eigen::Vector3d>, 5>& seen,
                 std::array<int, 5>& rows,
                 RefinementProblem& problem) {
    int num_matches = 0;
    for (size_t p = 0; p < 6; ++p) {
      const size_t q = p / 3;
      const size_t c = 2 + p % 3;
      if (!seen[q] || !seen[c]) continue;
      BearingPairs& pairs = problem.rigs.pairs[p];
      problem.inliers[p].push_back(static_cast<int>(pairs.size()));
      problem.keypoints[p].push_back({rows[q], rows[c]});
      pairs.query.push_back(*seen[q]);
      pairs.cand.push_back(*seen[c]);
      ++num_matches;
    }
    for (size_t c = 0; c < 5; ++c) rows[c] += seen[c] ? 1 : 0;
    return num_matches;
  }

  static constexpr double kFocal_px = 458.0;
  RefinementProblemOptions options_;
  std::mt19937_64 engine_;
};

inline RefinementProblem MakeRefinementProblem(const RefinementProblemOptions& options) {
  return RefinementProblemMaker(options).Make();
}

}  // namespace covinz
