#include "covinz/rig_hypotheses.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <stdexcept>

#include "covinz/generalized_relative_pose.h"
#include "covinz/random.h"
#include "covinz/relative_pose.h"
#include "hypothesis_pool.h"

namespace covinz {
namespace {

constexpr int kSampleSize = 5;
// A pose of one pair is dropped unless it explains this part of the matches of its pair that the
// best one explains ...
constexpr double kMinRelativeInliers = 0.5;
// ... and, besides its sample, more than this part of them, which chance reaches in one of a
// hundred cases. [measured on random matches at 3 px; in proportion to the width of the band]
constexpr double kChancePerPx = 0.013;
// Part of the upright samples of inliers that the error of the verticals leaves good.
constexpr double kUprightSuccess = 0.5;
// Loops that are more times as long than the longest baseline of a rig have no observable length.
constexpr double kMaxBaselineRatio = 50.0;

// One match of one pair.
struct Row {
  size_t pair;
  size_t match;
};

class Search {
 public:
  Search(const RigPairs& rigs, const RigHypothesisOptions& options, uint64_t seed)
      : rigs_(rigs),
        options_(options),
        sampson_(rigs, options.instruction_set),
        pool_(sampson_, options),
        random_(seed),
        max_distance_m_(kMaxBaselineRatio * LongestBaseline_m(rigs)),
        best_of_pair_(rigs.pairs.size(), 0) {}

  std::vector<RigHypothesis> Run();

 private:
  Row DrawRow(size_t without_pair);
  void SampleFivePlusOne();
  void SampleUpright();
  void TryDistances(size_t pair, const UnscaledPose& pose, const RayMatch& first);
  double ParallelRad(size_t pair) const;
  bool IsTooLong(const Eigen::Isometry3d& T_cand_query, const RayMatch& match) const;
  double GoodSampleProbability() const;

  const RigPairs& rigs_;
  const RigHypothesisOptions& options_;
  const RigSampson sampson_;
  HypothesisPool pool_;
  Random random_;
  double max_distance_m_;
  std::vector<int> best_of_pair_;  // inliers
  bool improved_ = false;
};

// Any match, or any of another pair.
Row Search::DrawRow(size_t without_pair) {
  int num_rows = sampson_.NumMatches();
  if (without_pair < sampson_.NumPairs()) num_rows -= sampson_.NumMatches(without_pair);
  int row = random_.Below(num_rows);
  for (size_t pair = 0;; ++pair) {
    if (pair == without_pair) continue;
    if (row < sampson_.NumMatches(pair)) return {pair, static_cast<size_t>(row)};
    row -= sampson_.NumMatches(pair);
  }
}

double Search::ParallelRad(size_t pair) const {
  return options_.max_error_px *
         std::hypot(1.0 / rigs_.pairs[pair].query_focal_px, 1.0 / rigs_.pairs[pair].cand_focal_px);
}

void Search::SampleUpright() {
  std::array<RayMatch, 4> four;
  std::array<Row, 4> rows;
  bool several_pairs = false;
  for (size_t i = 0; i < four.size(); ++i) {
    rows[i] = DrawRow(sampson_.NumPairs());
    four[i] = RayMatchOf(rigs_, rows[i].pair, rows[i].match);
    several_pairs |= rows[i].pair != rows[0].pair;
  }
  if (!several_pairs) return;
  const double error_rad = 2.0 * options_.vertical_sigma_rad;
  const double width_px =
      std::hypot(options_.max_error_px, error_rad * rigs_.pairs[rows[0].pair].query_focal_px);
  for (const Eigen::Isometry3d& T_cand_query : SolveUprightFourPoint(
           four, *options_.verticals, std::hypot(error_rad, ParallelRad(rows[0].pair)))) {
    if (IsTooLong(T_cand_query, four[0])) continue;
    improved_ |= pool_.ProposeRough(T_cand_query, width_px);
  }
}

void Search::SampleFivePlusOne() {
  const size_t pair = DrawRow(sampson_.NumPairs()).pair;
  const int num_matches = sampson_.NumMatches(pair);
  if (num_matches < kSampleSize || num_matches == sampson_.NumMatches()) return;
  std::vector<int> sample;
  random_.DrawDistinct(0, num_matches, kSampleSize, sample);
  std::array<RayMatch, kSampleSize> five;
  for (size_t i = 0; i < five.size(); ++i) {
    five[i] = RayMatchOf(rigs_, pair, static_cast<size_t>(sample[i]));
  }
  const double by_chance = kSampleSize + kChancePerPx * options_.max_error_px * num_matches;
  for (const UnscaledPose& pose : FivePointPoses(five, ParallelRad(pair))) {
    const int num_inliers =
        sampson_.ScorePair(pair, pose.R_cand_query, pose.direction, options_.max_error_px)
            .num_inliers;
    if (num_inliers <= std::max(kMinRelativeInliers * best_of_pair_[pair], by_chance)) continue;
    best_of_pair_[pair] = std::max(best_of_pair_[pair], num_inliers);
    TryDistances(pair, pose, five[0]);
  }
}

bool Search::IsTooLong(const Eigen::Isometry3d& T_cand_query, const RayMatch& match) const {
  return !((T_cand_query * match.query_centre - match.cand_centre).norm() <= max_distance_m_);
}

void Search::TryDistances(size_t pair, const UnscaledPose& pose, const RayMatch& first) {
  std::optional<Eigen::Isometry3d> best;
  double best_gain = 0.0;
  for (int i = 0; i < options_.num_scale_rays; ++i) {
    const Row row = DrawRow(pair);
    const std::optional<Eigen::Isometry3d> T_cand_query =
        ScaleByRay(pose, first, RayMatchOf(rigs_, row.pair, row.match));
    if (!T_cand_query || IsTooLong(*T_cand_query, first)) continue;
    const double gain = sampson_.Score(*T_cand_query, options_.max_error_px, pool_.Stride()).gain;
    if (gain <= best_gain) continue;
    best_gain = gain;
    best = T_cand_query;
  }
  if (best) improved_ |= pool_.Propose(*best);
}

// That a sample has inliers of the best pose only: five of a pair and one of the rays tried.
double Search::GoodSampleProbability() const {
  const std::vector<std::vector<int>> inliers = pool_.BestInliers();
  double num_inliers = 0.0;
  for (const std::vector<int>& of_pair : inliers)
    num_inliers += static_cast<double>(of_pair.size());
  double probability = 0.0;
  for (size_t p = 0; p < inliers.size(); ++p) {
    const double size = sampson_.NumMatches(p);
    const double size_others = sampson_.NumMatches() - size;
    if (size < kSampleSize || size_others < 1.0) continue;
    const double of_pair = static_cast<double>(inliers[p].size());
    const double no_ray =
        std::pow(1.0 - (num_inliers - of_pair) / size_others, options_.num_scale_rays);
    probability +=
        size / sampson_.NumMatches() * std::pow(of_pair / size, kSampleSize) * (1.0 - no_ray);
  }
  if (!options_.verticals) return probability;
  const double upright = std::pow(num_inliers / sampson_.NumMatches(), 4);
  return 0.5 * (probability + kUprightSuccess * upright);
}

std::vector<RigHypothesis> Search::Run() {
  int num_iterations = options_.max_num_iterations;
  for (int i = 0; i < num_iterations; ++i) {
    improved_ = false;
    if (options_.verticals && i % 2 == 1) {
      SampleUpright();
    } else {
      SampleFivePlusOne();
    }
    if (!improved_) continue;
    const int needed = NumRansacIterations(GoodSampleProbability(), options_.confidence,
                                           options_.max_num_iterations);
    num_iterations = std::max(needed, options_.min_num_iterations);
  }
  return pool_.Distinct();
}

}  // namespace

void RigHypothesisOptions::Check() const {
  if (!(max_error_px > 0.0)) {
    throw std::invalid_argument("RigHypothesisOptions.max_error_px must be positive");
  }
  if (!(confidence > 0.0 && confidence < 1.0)) {
    throw std::invalid_argument("RigHypothesisOptions.confidence must be in (0, 1)");
  }
  if (min_num_iterations < 1 || max_num_iterations < min_num_iterations) {
    throw std::invalid_argument("RigHypothesisOptions: 1 <= min_ <= max_num_iterations");
  }
  if (num_scale_rays < 1 || max_num_hypotheses < 1) {
    throw std::invalid_argument("RigHypothesisOptions: rays and hypotheses must be at least 1");
  }
  if (min_num_inliers < kSampleSize + 1) {
    throw std::invalid_argument("RigHypothesisOptions.min_num_inliers must be at least 6");
  }
  const auto is_unit = [](const Eigen::Vector3d& v) { return std::abs(v.norm() - 1.0) < 1e-6; };
  if (verticals && !(is_unit(verticals->query) && is_unit(verticals->cand))) {
    throw std::invalid_argument("RigHypothesisOptions.verticals must be unit vectors");
  }
  if (!(vertical_sigma_rad >= 0.0)) {
    throw std::invalid_argument("RigHypothesisOptions.vertical_sigma_rad must not be negative");
  }
  if (!(max_same_distance_m > 0.0 && max_same_angle_rad > 0.0)) {
    throw std::invalid_argument("RigHypothesisOptions: same distance and angle must be positive");
  }
  if (!(min_same_overlap >= 0.0 && min_same_overlap <= 1.0)) {
    throw std::invalid_argument("RigHypothesisOptions.min_same_overlap must be in [0, 1]");
  }
}

std::vector<RigHypothesis> EstimateRigHypotheses(const RigPairs& rigs,
                                                 const RigHypothesisOptions& options,
                                                 uint64_t seed) {
  options.Check();
  rigs.Check();
  if (rigs.NumMatches() < kSampleSize + 1) return {};
  return Search(rigs, options, seed).Run();
}

}  // namespace covinz
