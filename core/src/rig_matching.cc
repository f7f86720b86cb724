// Nearest neighbours in both directions from the kernels' keys, and the tests that make matches.
#include "covinz/rig_matching.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>

#include "filtered_matching.h"
#include "match_kernels.h"

namespace covinz {
namespace {

constexpr uint32_t kNone = UINT32_MAX;

// Distances are squared for L2.
struct Nearest {
  uint32_t distance = kNone;
  uint32_t index = 0;
};

struct TwoNearest {
  Nearest best;
  uint32_t second = kNone;  // distance

  // Takes a neighbour that may come in any order; of equals, the lower index is nearer.
  void Take(const Nearest& found) {
    const bool nearer = found.distance < best.distance ||
                        (found.distance == best.distance && found.index < best.index);
    second = std::min(second, nearer ? best.distance : found.distance);
    if (nearer) best = found;
  }
};

struct Neighbours {
  std::vector<TwoNearest> of_query;
  std::vector<Nearest> of_cand;
};

const MatchKernels& KernelsFor(InstructionSet instruction_set) {
  if (!IsSupported(instruction_set)) {
    throw std::invalid_argument("this processor lacks the instruction set asked for");
  }
  switch (instruction_set) {
    case InstructionSet::kAvx512:
      return kAvx512MatchKernels;
    case InstructionSet::kAvx2:
      return kAvx2MatchKernels;
    case InstructionSet::kSse42:
      return kSse42MatchKernels;
    case InstructionSet::kNeon:
      return kNeonMatchKernels;
    default:
      return kPortableMatchKernels;
  }
}

PackedView View(const PackedDescriptors& packed) {
  return {packed.groups().data(),        packed.words().data(), packed.sums().data(),
          packed.squared_norms().data(), packed.num_groups(),   packed.size()};
}

// Bits that the largest distance leaves for the index.
int KeyShift(size_t num_bytes, DescriptorNorm norm) {
  const uint32_t largest =
      static_cast<uint32_t>(num_bytes) * (norm == DescriptorNorm::kHamming ? 8u : 255u * 255u);
  int shift = 31;
  while (largest >> (31 - shift) != 0) --shift;
  return shift;
}

// Runs the kernels in chunks whose indices fit the keys.
class PairScan {
 public:
  PairScan(const PackedDescriptors& query,
           const PackedDescriptors& cand,
           DescriptorNorm norm,
           const MatchKernels& kernels)
      : num_lanes_(kernels.num_lanes),
        scan_(norm == DescriptorNorm::kHamming ? kernels.hamming : kernels.l2),
        num_vectors_((cand.size() + num_lanes_ - 1) / num_lanes_),
        column_keys_(cand.sums().size(), kNoKey),
        best_(kMaxTileRows),
        second_(kMaxTileRows) {
    tile_.query = View(query);
    tile_.cand = View(cand);
    tile_.key_shift = KeyShift(query.num_bytes(), norm);
    tile_.column_keys = column_keys_.data();
    tile_.best = best_.data();
    tile_.second = second_.data();
    neighbours_.of_query.resize(query.size());
    neighbours_.of_cand.resize(cand.size());
  }

  Neighbours Run() {
    const size_t chunk = size_t{1} << tile_.key_shift;
    const size_t num_rows = neighbours_.of_query.size();
    for (size_t begin = 0; begin < num_rows; begin += chunk) {
      const size_t end = std::min(begin + chunk, num_rows);
      for (size_t row = begin; row < end; row += kMaxTileRows) {
        tile_.first_row = row;
        tile_.num_rows = std::min(kMaxTileRows, end - row);
        tile_.first_row_index = static_cast<int32_t>(row - begin);
        for (size_t v = 0; v < num_vectors_; v += chunk / num_lanes_) {
          tile_.first_vector = v;
          tile_.num_vectors = std::min(chunk / num_lanes_, num_vectors_ - v);
          scan_(tile_);
          TakeRows();
        }
      }
      TakeColumns(begin);
    }
    return std::move(neighbours_);
  }

 private:
  void TakeRows() {
    for (size_t r = 0; r < tile_.num_rows; ++r) {
      TwoNearest& nearest = neighbours_.of_query[tile_.first_row + r];
      if (best_[r] != kNoKey) nearest.Take(Candidate(best_[r]));
      if (second_[r] != kNoKey) nearest.Take(Candidate(second_[r]));
    }
  }

  Nearest Candidate(int32_t key) const {
    const size_t first = tile_.first_vector * num_lanes_;
    return {Distance(key), static_cast<uint32_t>(first) + Index(key)};
  }

  void TakeColumns(size_t first_row) {
    for (size_t i = 0; i < neighbours_.of_cand.size(); ++i) {
      const int32_t key = column_keys_[i];
      Nearest& nearest = neighbours_.of_cand[i];
      if (Distance(key) < nearest.distance) {
        nearest = {Distance(key), static_cast<uint32_t>(first_row) + Index(key)};
      }
    }
    std::fill(column_keys_.begin(), column_keys_.end(), kNoKey);
  }

  uint32_t Distance(int32_t key) const { return static_cast<uint32_t>(key) >> tile_.key_shift; }
  uint32_t Index(int32_t key) const {
    return static_cast<uint32_t>(key) & ((uint32_t{1} << tile_.key_shift) - 1);
  }

  size_t num_lanes_;
  void (*scan_)(const MatchTile&);
  size_t num_vectors_;
  std::vector<int32_t> column_keys_;
  std::vector<int32_t> best_;
  std::vector<int32_t> second_;
  MatchTile tile_{};
  Neighbours neighbours_;
};

// As OpenCV gives it.
double AsDouble(uint32_t distance, DescriptorNorm norm) {
  const float value = static_cast<float>(distance);
  return norm == DescriptorNorm::kHamming ? value : std::sqrt(value);
}

bool IsMatch(const TwoNearest& found, const MatchingOptions& options) {
  const double best = AsDouble(found.best.distance, options.norm);
  if (best > options.max_distance) return false;
  if (options.max_ratio >= 1.0) return true;
  return found.second != kNone && best < options.max_ratio * AsDouble(found.second, options.norm);
}

// An image, and its nibbles where the kernels ask for them.
struct Prepared {
  const PackedDescriptors* packed;
  std::optional<NibbledDescriptors> nibbles;
};

Prepared Prepare(const PackedDescriptors& packed,
                 const MatchingOptions& options,
                 const MatchKernels& kernels) {
  const bool filtered = options.norm == DescriptorNorm::kHamming && kernels.nearest != nullptr &&
                        packed.num_groups() == PackedDescriptors::kStepBytes / sizeof(uint32_t);
  return {&packed, filtered ? std::make_optional<NibbledDescriptors>(packed) : std::nullopt};
}

std::vector<Match> MatchScanned(const PackedDescriptors& query,
                                const PackedDescriptors& cand,
                                const MatchingOptions& options,
                                const MatchKernels& kernels) {
  const Neighbours neighbours = PairScan(query, cand, options.norm, kernels).Run();
  std::vector<Match> matches;
  for (size_t q = 0; q < query.size(); ++q) {
    const TwoNearest& found = neighbours.of_query[q];
    const size_t c = found.best.index;
    if (!IsMatch(found, options)) continue;
    if (options.mutual && neighbours.of_cand[c].index != q) continue;
    matches.push_back({query.rows()[q], cand.rows()[c]});
  }
  return matches;
}

std::vector<Match> MatchPrepared(const Prepared& query,
                                 const Prepared& cand,
                                 const MatchingOptions& options,
                                 const MatchKernels& kernels) {
  const PackedDescriptors& q = *query.packed;
  const PackedDescriptors& c = *cand.packed;
  if (q.size() == 0 || c.size() == 0) return {};
  if (q.num_bytes() != c.num_bytes()) {
    throw std::invalid_argument("descriptors differ in length: " + std::to_string(q.num_bytes()) +
                                " and " + std::to_string(c.num_bytes()) + " bytes");
  }
  if (q.num_bytes() == 0) return {};
  if (query.nibbles && cand.nibbles) {
    return MatchFiltered(*query.nibbles, *cand.nibbles, options, kernels.nearest);
  }
  return MatchScanned(q, c, options, kernels);
}

}  // namespace

std::vector<Match> MatchPacked(const PackedDescriptors& query,
                               const PackedDescriptors& cand,
                               const MatchingOptions& options,
                               InstructionSet instruction_set) {
  options.Check();
  const MatchKernels& kernels = KernelsFor(instruction_set);
  return MatchPrepared(Prepare(query, options, kernels), Prepare(cand, options, kernels), options,
                       kernels);
}

std::vector<std::vector<Match>> MatchRigs(const std::vector<PackedDescriptors>& query,
                                          const std::vector<PackedDescriptors>& cand,
                                          const MatchingOptions& options,
                                          InstructionSet instruction_set) {
  options.Check();
  const MatchKernels& kernels = KernelsFor(instruction_set);
  std::vector<Prepared> prepared;
  for (const PackedDescriptors& c : cand) prepared.push_back(Prepare(c, options, kernels));
  std::vector<std::vector<Match>> matches;
  for (const PackedDescriptors& packed : query) {
    const Prepared q = Prepare(packed, options, kernels);
    for (const Prepared& c : prepared) {
      matches.push_back(MatchPrepared(q, c, options, kernels));
    }
  }
  return matches;
}

}  // namespace covinz
