// Dynamic programming over the keyframes on either side of a rig's reference.
#include "covinz/rig_neighbours.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <tuple>

namespace covinz {
namespace {

// What differs by less than this is equal, and then the nearer keyframe is taken: rounding, which
// changes with the odometry's frame, decides nothing.
constexpr double kQuantum = 1e-6;
// A few of them can be added.
constexpr double kMostQuanta = 1e17;

void Require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(std::string("Rig neighbours: ") + message);
}

int64_t Quantised(double value) {
  const double quanta = value / kQuantum;
  return quanta > 0.0 ? std::llrint(std::min(quanta, kMostQuanta)) : 0;
}

// Metres travelled and radians turned from the first keyframe on.
struct Along {
  double metres = 0.0;
  double radians = 0.0;

  Along From(const Along& other) const {
    return {std::abs(metres - other.metres), std::abs(radians - other.radians)};
  }
};

std::vector<Along> PathAlong(const std::vector<Eigen::Isometry3d>& T_odom_body) {
  std::vector<Along> along(T_odom_body.size());
  for (size_t i = 1; i < along.size(); ++i) {
    const Eigen::Isometry3d& T_prev = T_odom_body[i - 1];
    const Eigen::Isometry3d& T_cur = T_odom_body[i];
    along[i].metres = along[i - 1].metres + (T_cur.translation() - T_prev.translation()).norm();
    along[i].radians =
        along[i - 1].radians + RotationAngle(T_prev.linear().transpose() * T_cur.linear());
  }
  return along;
}

// Parts of the reference's view: what another camera has in view, and what it can be matched in.
struct Common {
  double seen = 0.0;
  double matched = 0.0;
};

Common CommonView(const CameraView& reference,
                  const CameraView& other,
                  const Eigen::Isometry3d& T_ref_other,
                  const RigNeighboursOptions& options) {
  Common common;
  for (const Eigen::Vector3d& ray : reference.rays()) {
    const Eigen::Vector3d sight = options.depth_m * ray - T_ref_other.translation();
    if (!other.Sees(T_ref_other.linear().transpose() * sight)) continue;
    common.seen += 1.0;
    const double distance_m = std::max(sight.norm(), 1e-9);
    const double turned_rad = std::acos(std::clamp(sight.dot(ray) / distance_m, -1.0, 1.0));
    const double nearer = std::log(distance_m / options.depth_m);
    const double half = options.half_view_change;
    common.matched += std::exp2(-(turned_rad * turned_rad + nearer * nearer) / (half * half));
  }
  const double num_rays = static_cast<double>(reference.rays().size());
  return {common.seen / num_rays, common.matched / num_rays};
}

// Part of the matches that stays inliers while odometry's rotation is taken as exact.
double PartHeld(const Along& between, double focal_px, const RigNeighboursOptions& options) {
  const double variance = std::pow(options.odometry.rotation_per_sqrt_m, 2) * between.metres +
                          std::pow(options.odometry.rotation_per_sqrt_rad, 2) * between.radians +
                          std::pow(options.odometry.min_rotation, 2);
  return std::erf(options.max_error_px / (std::sqrt(2.0 * variance) * focal_px));
}

// The keyframes that may form a rig with the reference.
class Neighbourhood {
 public:
  Neighbourhood(const std::vector<Eigen::Isometry3d>& T_odom_body,
                const std::vector<const CameraView*>& views,
                int reference,
                const RigNeighboursOptions& options);

  // Quanta of information about scale that two of them tell.
  int64_t Worth(int a, int b) const;

  // Rows from the reference to the one that is looked at last before (step -1) or after (1) it, the
  // nearest first.
  std::vector<int> Side(int step) const;

  bool HasOverlap(int row) const {
    return row == reference_ || common_[Index(row)].seen >= options_.min_overlap;
  }

  // More is better where nothing else is left.
  int64_t Rank(int row) const { return Quantised(common_[Index(row)].matched); }

 private:
  static size_t Index(int row) { return static_cast<size_t>(row); }

  const RigNeighboursOptions& options_;
  int reference_;
  int first_, last_;  // of those that are looked at
  std::vector<Along> along_;
  std::vector<Eigen::Vector3d> centres_m_;
  std::vector<Common> common_;
  std::vector<double> shared_;
};

Neighbourhood::Neighbourhood(const std::vector<Eigen::Isometry3d>& T_odom_body,
                             const std::vector<const CameraView*>& views,
                             int reference,
                             const RigNeighboursOptions& options)
    : options_(options),
      reference_(reference),
      first_(reference),
      last_(reference),
      along_(PathAlong(T_odom_body)),
      centres_m_(along_.size()),
      common_(along_.size()),
      shared_(along_.size(), 0.0) {
  const auto is_near = [&](int row) {
    const double metres = along_[Index(row)].From(along_[Index(reference)]).metres;
    return metres <= options.max_path_m || std::abs(row - reference) <= options.min_steps;
  };
  while (first_ > 0 && is_near(first_ - 1)) --first_;
  while (Index(last_) + 1 < along_.size() && is_near(last_ + 1)) ++last_;
  const CameraView& view = *views[Index(reference)];
  const Eigen::Isometry3d T_ref_odom =
      (T_odom_body[Index(reference)] * view.T_body_cam()).inverse();
  for (size_t i = Index(first_); i <= Index(last_); ++i) {
    const Eigen::Isometry3d T_odom_cam = T_odom_body[i] * views[i]->T_body_cam();
    centres_m_[i] = T_odom_cam.translation();
    common_[i] = CommonView(view, *views[i], T_ref_odom * T_odom_cam, options);
    const Along between = along_[i].From(along_[Index(reference)]);
    const double held = i == Index(reference) ? 1.0 : PartHeld(between, view.focal_px(), options);
    shared_[i] = common_[i].matched * held;
  }
}

int64_t Neighbourhood::Worth(int a, int b) const {
  const size_t i = Index(a);
  const size_t j = Index(b);
  const Along between = along_[i].From(along_[j]);
  const double variance =
      std::pow(options_.odometry.translation_per_sqrt_m, 2) * between.metres +
      std::pow(options_.odometry.translation_per_sqrt_rad, 2) * between.radians +
      std::pow(options_.odometry.min_translation, 2);
  const double squared = (centres_m_[i] - centres_m_[j]).squaredNorm();
  return Quantised(std::min(shared_[i], shared_[j]) * squared / variance);
}

std::vector<int> Neighbourhood::Side(int step) const {
  std::vector<int> rows;
  for (int row = reference_; row >= first_ && row <= last_; row += step) rows.push_back(row);
  return rows;
}

// Rows besides the reference, the nearest first, and what the links from each to the next tell.
struct Chain {
  int64_t worth = 0;
  std::vector<int> rows;
};

// The best chains of 0, 1, 2 .. up to num_others rows of one side of the reference; of equal ones
// those of nearer rows.
std::vector<Chain> BestChains(const Neighbourhood& around, int step, size_t num_others) {
  std::vector<int> rows = around.Side(step);
  rows.erase(
      std::remove_if(rows.begin(), rows.end(), [&](int row) { return !around.HasOverlap(row); }),
      rows.end());
  const size_t num_rows = rows.size();
  std::vector<int64_t> links(num_rows * num_rows, 0);
  for (size_t a = 0; a < num_rows; ++a) {
    for (size_t b = 0; b < a; ++b) links[num_rows * a + b] = around.Worth(rows[b], rows[a]);
  }
  // Of the chains of so many rows that end at each one: the most worth, and the row before.
  std::vector<int64_t> worth(num_rows, -1);
  worth[0] = 0;
  std::vector<std::vector<size_t>> before;
  std::vector<Chain> chains(1);
  while (before.size() < std::min(num_others, num_rows - 1)) {
    std::vector<int64_t> next(num_rows, -1);
    before.emplace_back(num_rows, 0);
    for (size_t a = 1; a < num_rows; ++a) {
      for (size_t b = 0; b < a; ++b) {
        if (worth[b] < 0 || worth[b] + links[num_rows * a + b] <= next[a]) continue;
        next[a] = worth[b] + links[num_rows * a + b];
        before.back()[a] = b;
      }
    }
    worth = std::move(next);
    size_t at = static_cast<size_t>(std::max_element(worth.begin(), worth.end()) - worth.begin());
    Chain chain{worth[at], {}};
    for (auto came = before.rbegin(); came != before.rend(); at = (*came++)[at]) {
      chain.rows.insert(chain.rows.begin(), rows[at]);
    }
    chains.push_back(std::move(chain));
  }
  return chains;
}

// Up to num_others rows whose chain through the reference is worth most; of equal chains the one
// that is as long on both sides.
std::vector<int> BestChain(const Neighbourhood& around, size_t num_others) {
  const std::vector<Chain> one = BestChains(around, -1, num_others);
  const std::vector<Chain> other = BestChains(around, 1, num_others);
  const size_t count = std::min(num_others, one.size() + other.size() - 2);
  // Least of: minus the worth, how uneven, minus the rows before.
  std::tuple<int64_t, int, int> least(1, 0, 0);
  std::vector<int> best;
  for (size_t num = 0; num <= count; ++num) {
    if (num >= one.size() || count - num >= other.size()) continue;
    const int before = static_cast<int>(num);
    const int uneven = std::abs(2 * before - static_cast<int>(count));
    const std::tuple<int64_t, int, int> split(-(one[num].worth + other[count - num].worth), uneven,
                                              -before);
    if (split >= least) continue;
    least = split;
    best = one[num].rows;
    best.insert(best.end(), other[count - num].rows.begin(), other[count - num].rows.end());
  }
  return best;
}

// Up to `count` rows that are not taken, those that can be matched best with the reference.
std::vector<int> Rest(const Neighbourhood& around,
                      const std::vector<int>& taken,
                      int reference,
                      size_t count) {
  std::vector<int> rows;
  if (count == 0) return rows;
  for (const int step : {-1, 1}) {
    for (const int row : around.Side(step)) {
      const bool is_taken = std::find(taken.begin(), taken.end(), row) != taken.end();
      if (row != reference && !is_taken) rows.push_back(row);
    }
  }
  const auto order = [&](int row) {
    return std::make_tuple(-around.Rank(row), std::abs(row - reference), row);
  };
  std::sort(rows.begin(), rows.end(), [&](int a, int b) { return order(a) < order(b); });
  if (rows.size() > count) rows.resize(count);
  return rows;
}

}  // namespace

void RigNeighboursOptions::Check() const {
  Require(depth_m > 0.0, "depth_m must be positive");
  Require(half_view_change > 0.0, "half_view_change must be positive");
  Require(min_overlap >= 0.0 && min_overlap <= 1.0, "min_overlap must be 0 to 1");
  Require(max_path_m >= 0.0, "max_path_m must not be negative");
  Require(min_steps >= 0, "min_steps must not be negative");
  Require(max_error_px > 0.0, "max_error_px must be positive");
  odometry.Check();
}

RigChoice ChooseRig(const std::vector<Eigen::Isometry3d>& T_odom_body,
                    const std::vector<const CameraView*>& views,
                    int reference,
                    int size,
                    const RigNeighboursOptions& options) {
  options.Check();
  Require(T_odom_body.size() == views.size(), "the numbers of poses and views differ");
  Require(reference >= 0 && static_cast<size_t>(reference) < views.size(),
          "the reference is no row");
  Require(size >= 1, "a rig has at least its reference");
  const Neighbourhood around(T_odom_body, views, reference, options);
  const size_t num_others = std::min(static_cast<size_t>(size), views.size()) - 1;
  std::vector<int> in_time = BestChain(around, num_others);
  const std::vector<int> rest = Rest(around, in_time, reference, num_others - in_time.size());
  in_time.insert(in_time.end(), rest.begin(), rest.end());
  RigChoice choice{{reference}, 0.0};
  std::sort(in_time.begin(), in_time.end());
  choice.rows.insert(choice.rows.end(), in_time.begin(), in_time.end());
  in_time.insert(std::upper_bound(in_time.begin(), in_time.end(), reference), reference);
  int64_t worth = 0;
  for (size_t i = 1; i < in_time.size(); ++i) worth += around.Worth(in_time[i - 1], in_time[i]);
  choice.information = kQuantum * static_cast<double>(worth);
  return choice;
}

}  // namespace covinz
