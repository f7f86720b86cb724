#include "covinz/rig_relative_pose.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "covinz/random.h"
#include "covinz/relative_pose.h"
#include "rig_solver.h"

namespace covinz {
namespace {

Eigen::Isometry3d CameraPose(const RigPairs& rigs,
                             const BearingPairs& pairs,
                             const Eigen::Isometry3d& T_cand_query) {
  return rigs.T_cand_cam[static_cast<size_t>(pairs.cand_cam)].inverse() * T_cand_query *
         rigs.T_query_cam[static_cast<size_t>(pairs.query_cam)];
}

// Upper bound of the number of inliers: depths are not looked at.
int CountSampsonInliers(const RigPairs& rigs,
                        const Eigen::Isometry3d& T_cand_query,
                        double max_error_px) {
  int count = 0;
  for (const BearingPairs& pairs : rigs.pairs) {
    const Eigen::Matrix3d E = EssentialMatrix(CameraPose(rigs, pairs, T_cand_query));
    for (size_t i = 0; i < pairs.size(); ++i) {
      if (SquaredSampsonError_px2(E, pairs, i) <= max_error_px * max_error_px) ++count;
    }
  }
  return count;
}

void KeepIfBetter(const RigPairs& rigs,
                  const Eigen::Isometry3d& T_cand_query,
                  double max_error_px,
                  RigRelativePose& best) {
  if (CountSampsonInliers(rigs, T_cand_query, max_error_px) <= best.num_inliers) return;
  std::vector<std::vector<int>> inliers;
  int num_inliers = 0;
  for (const BearingPairs& pairs : rigs.pairs) {
    inliers.push_back(FindInliers(CameraPose(rigs, pairs, T_cand_query), pairs, max_error_px));
    num_inliers += static_cast<int>(inliers.back().size());
  }
  if (num_inliers <= best.num_inliers) return;
  best.T_cand_query = T_cand_query;
  best.inliers = std::move(inliers);
  best.num_inliers = num_inliers;
}

std::vector<std::vector<int>> AllMatches(const RigPairs& rigs) {
  std::vector<std::vector<int>> all;
  for (const BearingPairs& pairs : rigs.pairs) {
    all.emplace_back(pairs.size());
    std::iota(all.back().begin(), all.back().end(), 0);
  }
  return all;
}

// Part of the inliers of the estimate that another pose keeps.
double InlierRatio(const RigPairs& rigs,
                   const RigRelativePose& estimate,
                   const Eigen::Isometry3d& T_cand_query,
                   double max_error_px) {
  int count = 0;
  for (size_t p = 0; p < rigs.pairs.size(); ++p) {
    const BearingPairs& pairs = rigs.pairs[p];
    const Eigen::Matrix3d E = EssentialMatrix(CameraPose(rigs, pairs, T_cand_query));
    for (const int i : estimate.inliers[p]) {
      if (SquaredSampsonError_px2(E, pairs, static_cast<size_t>(i)) <=
          max_error_px * max_error_px) {
        ++count;
      }
    }
  }
  return static_cast<double>(count) / estimate.num_inliers;
}

}  // namespace

size_t RigPairs::NumMatches() const {
  return std::accumulate(pairs.begin(), pairs.end(), size_t{0},
                         [](size_t sum, const BearingPairs& p) { return sum + p.size(); });
}

void RigPairs::Check() const {
  for (const BearingPairs& p : pairs) {
    p.Check();
    if (p.query_cam < 0 || p.query_cam >= static_cast<int>(T_query_cam.size()) || p.cand_cam < 0 ||
        p.cand_cam >= static_cast<int>(T_cand_cam.size())) {
      throw std::invalid_argument("RigPairs: a pair names a camera that its rig does not have");
    }
  }
}

double LongestBaseline_m(const RigPairs& rigs) {
  double longest_m = 0.0;
  for (const std::vector<Eigen::Isometry3d>* cams : {&rigs.T_query_cam, &rigs.T_cand_cam}) {
    for (const Eigen::Isometry3d& a : *cams) {
      for (const Eigen::Isometry3d& b : *cams) {
        longest_m = std::max(longest_m, (a.translation() - b.translation()).norm());
      }
    }
  }
  return longest_m;
}

void RigRelativePoseOptions::Check() const {
  if (!(max_error_px > 0.0)) {
    throw std::invalid_argument("RigRelativePoseOptions.max_error_px must be positive");
  }
  if (!(confidence > 0.0 && confidence < 1.0)) {
    throw std::invalid_argument("RigRelativePoseOptions.confidence must be in (0, 1)");
  }
  if (max_num_iterations < 1) {
    throw std::invalid_argument("RigRelativePoseOptions.max_num_iterations must be at least 1");
  }
}

std::optional<RigRelativePose> EstimateRigRelativePose(const RigPairs& rigs,
                                                       const RigRelativePoseOptions& options,
                                                       uint64_t seed) {
  options.Check();
  rigs.Check();
  const SeventeenPointSolver solver(rigs, AllMatches(rigs));
  if (solver.NumMatches() < SeventeenPointSolver::kSampleSize) return std::nullopt;

  Random random(seed);
  RigRelativePose best{Eigen::Isometry3d::Identity(), {}, 0, 0};
  int num_iterations = options.max_num_iterations;
  while (best.num_iterations < num_iterations) {
    ++best.num_iterations;
    const std::optional<Eigen::Isometry3d> T_cand_query = solver.Solve(solver.DrawSample(random));
    if (!T_cand_query) continue;
    KeepIfBetter(rigs, *T_cand_query, options.max_error_px, best);
    const double inlier_ratio = static_cast<double>(best.num_inliers) / solver.NumMatches();
    num_iterations = NumRansacIterations(std::pow(inlier_ratio, SeventeenPointSolver::kSampleSize),
                                         options.confidence, options.max_num_iterations);
  }
  if (best.num_inliers < SeventeenPointSolver::kSampleSize) return std::nullopt;
  return best;
}

void RigCovarianceOptions::Check() const {
  if (num_samples < 7) {
    throw std::invalid_argument("RigCovarianceOptions.num_samples must be at least 7");
  }
  if (max_num_tries < num_samples) {
    throw std::invalid_argument("RigCovarianceOptions.max_num_tries must allow num_samples");
  }
  if (!(min_inlier_ratio >= 0.0 && min_inlier_ratio <= 1.0)) {
    throw std::invalid_argument("RigCovarianceOptions.min_inlier_ratio must be in [0, 1]");
  }
  if (!(max_error_px > 0.0)) {
    throw std::invalid_argument("RigCovarianceOptions.max_error_px must be positive");
  }
  if (!(min_sigma_rotation_rad > 0.0 && min_sigma_translation_m > 0.0)) {
    throw std::invalid_argument("RigCovarianceOptions: least sigmas must be positive");
  }
}

RigCovariance SampleRigCovariance(const RigPairs& rigs,
                                  const RigRelativePose& estimate,
                                  const RigCovarianceOptions& options,
                                  uint64_t seed) {
  options.Check();
  rigs.Check();
  const SeventeenPointSolver solver(rigs, estimate.inliers);
  RigCovariance result{Matrix6d::Zero(), 0};
  if (solver.NumMatches() < SeventeenPointSolver::kSampleSize) return result;

  Random random(seed);
  const Eigen::Isometry3d T_query_cand = estimate.T_cand_query.inverse();
  for (int i = 0; i < options.max_num_tries && result.num_samples < options.num_samples; ++i) {
    const std::optional<Eigen::Isometry3d> T_cand_query = solver.Solve(solver.DrawSample(random));
    if (!T_cand_query || InlierRatio(rigs, estimate, *T_cand_query, options.max_error_px) <
                             options.min_inlier_ratio) {
      continue;
    }
    const Vector6d deviation = LogSE3(T_query_cand * *T_cand_query);
    result.covariance += deviation * deviation.transpose();
    ++result.num_samples;
  }
  if (result.num_samples > 0) result.covariance /= result.num_samples;
  result.covariance.diagonal().head<3>().array() +=
      options.min_sigma_rotation_rad * options.min_sigma_rotation_rad;
  result.covariance.diagonal().tail<3>().array() +=
      options.min_sigma_translation_m * options.min_sigma_translation_m;
  return result;
}

}  // namespace covinz
