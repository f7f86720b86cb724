#include "covinz/solve_loop.h"

#include <cmath>
#include <stdexcept>

#include <Eigen/Cholesky>

#include "covinz/random.h"
#include "stage_clock.h"

namespace covinz {
namespace {

// Streams of the seed; camera pair p uses kFirstPairStream + p.
constexpr uint64_t kRigStream = 0;
constexpr uint64_t kCovarianceStream = 1;
constexpr uint64_t kScaleStream = 2;
constexpr uint64_t kFirstPairStream = 3;

// What the stages have found so far.
struct Progress {
  RigPairs rigs;  // matches, later only their five-point inliers
  std::vector<int> num_matches;
  std::vector<int> num_pair_inliers;
};

std::vector<int> RowsWithBearing(const RigCamera& camera) {
  std::vector<int> rows;
  for (Eigen::Index i = 0; i < camera.bearings.rows(); ++i) {
    if (camera.bearings.row(i).allFinite()) rows.push_back(static_cast<int>(i));
  }
  return rows;
}

BearingPairs MatchCameras(const RigCamera& query,
                          const RigCamera& cand,
                          const MatchingOptions& options) {
  const std::vector<int> query_rows = RowsWithBearing(query);
  const std::vector<int> cand_rows = RowsWithBearing(cand);
  const std::vector<Match> matches = MatchDescriptors(
      query.descriptors(query_rows, Eigen::all), cand.descriptors(cand_rows, Eigen::all), options);
  BearingPairs pairs;
  pairs.query_focal_px = query.focal_px;
  pairs.cand_focal_px = cand.focal_px;
  for (const Match& match : matches) {
    pairs.query.push_back(query.bearings.row(query_rows[static_cast<size_t>(match.query)]));
    pairs.cand.push_back(cand.bearings.row(cand_rows[static_cast<size_t>(match.cand)]));
  }
  return pairs;
}

std::optional<LoopRejection> MatchRigs(const std::vector<RigCamera>& query,
                                       const std::vector<RigCamera>& cand,
                                       const LoopOptions& options,
                                       Progress& progress) {
  for (size_t q = 0; q < query.size(); ++q) {
    for (size_t c = 0; c < cand.size(); ++c) {
      BearingPairs pairs = MatchCameras(query[q], cand[c], options.matching);
      pairs.query_cam = static_cast<int>(q);
      pairs.cand_cam = static_cast<int>(c);
      const int num_matches = static_cast<int>(pairs.size());
      if (num_matches < options.min_num_matches) {
        return LoopRejection{"matches", static_cast<int>(q * cand.size() + c),
                             static_cast<double>(num_matches),
                             static_cast<double>(options.min_num_matches)};
      }
      progress.num_matches.push_back(num_matches);
      progress.rigs.pairs.push_back(std::move(pairs));
    }
  }
  return std::nullopt;
}

void KeepOnly(const std::vector<int>& kept, BearingPairs& pairs) {
  for (size_t i = 0; i < kept.size(); ++i) {
    pairs.query[i] = pairs.query[static_cast<size_t>(kept[i])];
    pairs.cand[i] = pairs.cand[static_cast<size_t>(kept[i])];
  }
  pairs.query.resize(kept.size());
  pairs.cand.resize(kept.size());
}

std::optional<LoopRejection> FilterPairs(const LoopOptions& options, Progress& progress) {
  for (size_t p = 0; p < progress.rigs.pairs.size(); ++p) {
    BearingPairs& pairs = progress.rigs.pairs[p];
    const std::optional<RelativePose> pose =
        EstimateRelativePose(pairs, options.pair, DeriveSeed(options.seed, kFirstPairStream + p));
    const std::vector<int> inliers = pose ? pose->inliers : std::vector<int>{};
    const int num_inliers = static_cast<int>(inliers.size());
    if (num_inliers < options.min_num_pair_inliers) {
      return LoopRejection{"pair_inliers", static_cast<int>(p), static_cast<double>(num_inliers),
                           static_cast<double>(options.min_num_pair_inliers)};
    }
    progress.num_pair_inliers.push_back(num_inliers);
    KeepOnly(inliers, pairs);
  }
  return std::nullopt;
}

std::optional<LoopRejection> CheckPlausible(const LoopEstimate& loop, const LoopOptions& options) {
  const double trace = loop.covariance.trace();
  if (!(trace <= options.max_covariance_trace)) {
    return LoopRejection{"uncertainty", std::nullopt, trace, options.max_covariance_trace};
  }
  const Vector6d xi = LogSE3(loop.T_cand_query);
  if (xi.tail<3>().norm() > options.max_translation_m) {
    return LoopRejection{"translation", std::nullopt, xi.tail<3>().norm(),
                         options.max_translation_m};
  }
  if (xi.head<3>().norm() > options.max_rotation_rad) {
    return LoopRejection{"rotation", std::nullopt, xi.head<3>().norm(), options.max_rotation_rad};
  }
  return std::nullopt;
}

LoopResult EstimateLoop(const LoopOptions& options, const Progress& progress, StageClock& clock) {
  clock.Start("rig");
  const std::optional<RigRelativePose> pose =
      EstimateRigRelativePose(progress.rigs, options.rig, DeriveSeed(options.seed, kRigStream));
  const int num_inliers = pose ? pose->num_inliers : 0;
  if (num_inliers < options.min_num_rig_inliers || !pose) {
    return LoopRejection{"rig_inliers", std::nullopt, static_cast<double>(num_inliers),
                         static_cast<double>(options.min_num_rig_inliers)};
  }
  const double ratio = CommonCentreRatio(progress.rigs, *pose, options.scale,
                                         DeriveSeed(options.seed, kScaleStream));
  if (ratio > options.scale.max_common_centre_ratio) {
    return LoopRejection{"scale", std::nullopt, ratio, options.scale.max_common_centre_ratio};
  }
  clock.Start("covariance");
  const RigCovariance sampled = SampleRigCovariance(progress.rigs, *pose, options.covariance,
                                                    DeriveSeed(options.seed, kCovarianceStream));
  if (sampled.num_samples < options.covariance.num_samples) {
    return LoopRejection{"covariance", std::nullopt, static_cast<double>(sampled.num_samples),
                         static_cast<double>(options.covariance.num_samples)};
  }
  const LoopEstimate loop{pose->T_cand_query,   sampled.covariance,        num_inliers,
                          progress.num_matches, progress.num_pair_inliers, pose->num_iterations};
  if (std::optional<LoopRejection> rejection = CheckPlausible(loop, options)) return *rejection;
  return loop;
}

LoopResult Solve(const std::vector<RigCamera>& query,
                 const std::vector<RigCamera>& cand,
                 const LoopOptions& options,
                 StageClock& clock) {
  Progress progress;
  for (const RigCamera& camera : query) {
    camera.Check();
    progress.rigs.T_query_cam.push_back(camera.T_rig_cam);
  }
  for (const RigCamera& camera : cand) {
    camera.Check();
    progress.rigs.T_cand_cam.push_back(camera.T_rig_cam);
  }
  const double baseline_m = LongestBaseline_m(progress.rigs);
  if (baseline_m < options.min_baseline_m) {
    return LoopRejection{"degenerate", std::nullopt, baseline_m, options.min_baseline_m};
  }
  clock.Start("matching");
  if (std::optional<LoopRejection> rejection = MatchRigs(query, cand, options, progress)) {
    return *rejection;
  }
  clock.Start("pairs");
  if (std::optional<LoopRejection> rejection = FilterPairs(options, progress)) return *rejection;
  return EstimateLoop(options, progress, clock);
}

}  // namespace

void RigCamera::Check() const {
  if (bearings.rows() != descriptors.rows()) {
    throw std::invalid_argument("RigCamera: " + std::to_string(bearings.rows()) + " bearings but " +
                                std::to_string(descriptors.rows()) + " descriptors");
  }
  for (Eigen::Index i = 0; i < bearings.rows(); ++i) {
    if (bearings.row(i).allFinite() && std::abs(bearings.row(i).norm() - 1.0) > 1e-6) {
      throw std::invalid_argument("RigCamera: bearings must be unit vectors or NaN");
    }
  }
  if (!(focal_px > 0.0 && std::isfinite(focal_px))) {
    throw std::invalid_argument("RigCamera.focal_px must be positive and finite");
  }
  const Eigen::Matrix3d R = T_rig_cam.linear();
  if (!T_rig_cam.matrix().allFinite() || !R.isUnitary(1e-6) || R.determinant() < 0.0 ||
      T_rig_cam.matrix().row(3) != Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0)) {
    throw std::invalid_argument("RigCamera.T_rig_cam must be a rigid transform");
  }
}

void LoopOptions::Check() const {
  matching.Check();
  pair.Check();
  rig.Check();
  scale.Check();
  covariance.Check();
  if (min_num_matches < 0 || min_num_pair_inliers < 0 || min_num_rig_inliers < 0) {
    throw std::invalid_argument("LoopOptions: least numbers must not be negative");
  }
  if (!(min_baseline_m > 0.0)) {
    throw std::invalid_argument("LoopOptions.min_baseline_m must be positive");
  }
  if (!(max_translation_m > 0.0 && max_rotation_rad > 0.0 && max_covariance_trace > 0.0)) {
    throw std::invalid_argument("LoopOptions: limits must be positive");
  }
}

LoopResult SolveLoop(const std::vector<RigCamera>& query,
                     const std::vector<RigCamera>& cand,
                     const LoopOptions& options) {
  options.Check();
  if (query.empty() || cand.empty()) throw std::invalid_argument("a rig needs a camera");
  StageClock clock;
  LoopResult result = Solve(query, cand, options, clock);
  std::visit([&clock](auto& value) { value.stage_ms = clock.Times(); }, result);
  return result;
}

}  // namespace covinz
