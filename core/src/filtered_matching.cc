// Rows in tiles, the table of the ratio test, and the mutual check.
#include "filtered_matching.h"

#include <algorithm>
#include <cmath>

namespace covinz {
namespace {

constexpr int32_t kNumBits = 256;
constexpr size_t kNumGroups = 8;
constexpr size_t kGroupBits = 32;
// More distances a row that the bounds leave open cost as much as another group does.
constexpr size_t kMaxVerified = 16;

// What a row looks for, and what it found.
struct Row {
  const uint64_t* words;
  int32_t max_distance;
};

struct Nearest {
  size_t index = kNoIndex;
  int32_t distance = 0;
};

// Groups whose bits exceed the distance for nearly all unrelated descriptors: if bits are
// independent, half of them differ, within 1.5 standard deviations in 93 %.
size_t NumBoundGroups(int32_t distance) {
  for (size_t groups = 1; groups < kNumGroups; ++groups) {
    const double num_bits = static_cast<double>(groups * kGroupBits);
    if (distance <= 0.5 * num_bits - 1.5 * std::sqrt(num_bits)) return groups;
  }
  return kNumGroups;
}

// The nearest one of each row in one image, by tiles of rows.
std::vector<Nearest> FindAll(const std::vector<Row>& rows,
                             const NibbledDescriptors& others,
                             const int32_t* spoilers,
                             void (*find_nearest)(NearestTile*)) {
  std::vector<Nearest> found(rows.size());
  NearestTile tile{};
  tile.others = others.View();
  tile.spoilers = spoilers;
  std::vector<NibbledDescriptors::Line> bounds(kMaxTileRows * tile.others.num_padded /
                                               sizeof(NibbledDescriptors::Line));
  tile.bounds = bounds.data()->bytes;
  int32_t max_distance = 0;
  for (const Row& row : rows) max_distance = std::max(max_distance, row.max_distance);
  tile.num_bound_groups = NumBoundGroups(max_distance);
  for (size_t begin = 0; begin < rows.size(); begin += kMaxTileRows) {
    tile.num_rows = std::min(kMaxTileRows, rows.size() - begin);
    for (size_t r = 0; r < tile.num_rows; ++r) {
      tile.rows[r] = rows[begin + r].words;
      tile.max_distances[r] = rows[begin + r].max_distance;
    }
    find_nearest(&tile);
    for (size_t r = 0; r < tile.num_rows; ++r) {
      found[begin + r] = {tile.indices[r], tile.distances[r]};
    }
    // Bits of real images depend on one another, so the bounds by the rule above may be poor.
    if (tile.num_verified > kMaxVerified * tile.num_rows) {
      tile.num_bound_groups = std::min(kNumGroups, tile.num_bound_groups + 1);
    }
  }
  return found;
}

// For each distance of a nearest one, the largest distance of another that fails the ratio test.
std::vector<int32_t> Spoilers(double max_ratio) {
  std::vector<int32_t> spoilers(kNumBits + 1);
  int32_t spoiler = 0;
  for (int32_t best = 0; best <= kNumBits; ++best) {
    while (spoiler < kNumBits && !(best < max_ratio * (spoiler + 1))) ++spoiler;
    spoilers[static_cast<size_t>(best)] = spoiler;
  }
  return spoilers;
}

}  // namespace

NibbledDescriptors::NibbledDescriptors(const PackedDescriptors& descriptors)
    : descriptors_(&descriptors),
      num_padded_((descriptors.size() + kNibbleBlock - 1) / kNibbleBlock * kNibbleBlock),
      lines_(kNumBits / 4 * num_padded_ / sizeof(Line)) {
  constexpr size_t kLanes = PackedDescriptors::kLanes;
  const uint32_t* groups = descriptors.groups().data();
  for (size_t first = 0; first < descriptors.size(); first += kLanes) {
    for (size_t g = 0; g < kNumGroups; ++g, groups += kLanes) {
      Line* lines = lines_.data() + (g * num_padded_ / kNibbleBlock + first / kNibbleBlock) * 8;
      for (size_t n = 0; n < 8; ++n) {
        uint8_t* nibbles = lines[n].bytes + first % kNibbleBlock;
        for (size_t lane = 0; lane < kLanes; ++lane) {
          nibbles[lane] = static_cast<uint8_t>(groups[lane] >> (4 * n) & 15u);
        }
      }
    }
  }
}

NibbleView NibbledDescriptors::View() const {
  return {lines_.data()->bytes, num_padded_, descriptors_->words().data(), size()};
}

std::vector<Match> MatchFiltered(const NibbledDescriptors& query,
                                 const NibbledDescriptors& cand,
                                 const MatchingOptions& options,
                                 void (*find_nearest)(NearestTile*)) {
  const bool distinct = options.max_ratio < 1.0;
  if (query.size() == 0 || cand.size() < (distinct ? 2 : 1)) return {};
  const int32_t max_distance =
      static_cast<int32_t>(std::min(static_cast<double>(kNumBits), options.max_distance));
  std::vector<Row> rows;
  for (size_t q = 0; q < query.size(); ++q) rows.push_back({query.Words(q), max_distance});
  const std::vector<int32_t> spoilers = Spoilers(options.max_ratio);
  const std::vector<Nearest> nearest =
      FindAll(rows, cand, distinct ? spoilers.data() : nullptr, find_nearest);
  std::vector<size_t> found;
  rows.clear();
  for (size_t q = 0; q < query.size(); ++q) {
    if (nearest[q].index == kNoIndex) continue;
    found.push_back(q);
    rows.push_back({cand.Words(nearest[q].index), nearest[q].distance});
  }
  std::vector<Nearest> back;
  if (options.mutual) back = FindAll(rows, query, nullptr, find_nearest);
  std::vector<Match> matches;
  for (size_t i = 0; i < found.size(); ++i) {
    if (options.mutual && back[i].index != found[i]) continue;
    matches.push_back({query.row(found[i]), cand.row(nearest[found[i]].index)});
  }
  return matches;
}

}  // namespace covinz
