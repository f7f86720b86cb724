// The loop over a tile of descriptor pairs that all match_kernels_*.cc share; each is compiled with
// another instruction set, so everything here is internal to the file that includes it.
#pragma once

#include "match_kernels.h"

// Passing a vector by value depends on the instruction set, so functions on them are always
// inlined.
#define COVINZ_INLINE static inline __attribute__((always_inline))

namespace covinz {
namespace {

constexpr size_t kBlockLanes = 16;  // PackedDescriptors::kLanes
constexpr size_t kStepGroups = 8;   // PackedDescriptors::kStepBytes / 4
constexpr size_t kMaxGroups = 256;  // PackedDescriptors::kMaxBytes / 4

// A vector of COVINZ_LANES keys or groups.
typedef int32_t Lanes __attribute__((vector_size(4 * COVINZ_LANES)));
typedef uint32_t UnsignedLanes __attribute__((vector_size(4 * COVINZ_LANES)));
typedef uint8_t ByteLanes __attribute__((vector_size(4 * COVINZ_LANES)));

COVINZ_INLINE Lanes Min(Lanes a, Lanes b) { return a < b ? a : b; }
COVINZ_INLINE Lanes Max(Lanes a, Lanes b) { return a > b ? a : b; }

template <typename Vector, typename Scalar>
COVINZ_INLINE Vector Load(const Scalar* p) {
  Vector lanes;
  __builtin_memcpy(&lanes, p, sizeof(lanes));
  return lanes;
}

COVINZ_INLINE void Store(int32_t* p, Lanes lanes) { __builtin_memcpy(p, &lanes, sizeof(lanes)); }

COVINZ_INLINE UnsignedLanes Broadcast(uint32_t value) { return UnsignedLanes{} + value; }

// Groups of the descriptor, or of the vector of descriptors that begins with it: its group g is at
// [g * kBlockLanes].
COVINZ_INLINE const uint32_t* GroupsFrom(const PackedView& packed, size_t descriptor) {
  return packed.groups + descriptor / kBlockLanes * kBlockLanes * packed.num_groups +
         descriptor % kBlockLanes;
}

// kNoKey in lanes beyond the last candidate.
COVINZ_INLINE Lanes Beyond(const MatchTile& tile, size_t first_cand) {
  Lanes mask = {};
  if (first_cand + COVINZ_LANES <= tile.cand.size) return mask;
  for (size_t lane = 0; lane < COVINZ_LANES; ++lane) {
    mask[lane] = first_cand + lane < tile.cand.size ? 0 : kNoKey;
  }
  return mask;
}

// The least and the second least of all lanes.
COVINZ_INLINE void Reduce(const Lanes& best_lanes,
                          const Lanes& second_lanes,
                          int32_t* least,
                          int32_t* second_least) {
  int32_t best[COVINZ_LANES];
  int32_t second[COVINZ_LANES];
  Store(best, best_lanes);
  Store(second, second_lanes);
  for (size_t half = COVINZ_LANES / 2; half > 0; half /= 2) {
    for (size_t i = 0; i < half; ++i) {
      const int32_t a = best[i];
      const int32_t b = best[i + half];
      const int32_t c = second[i] < second[i + half] ? second[i] : second[i + half];
      const int32_t worse = a < b ? b : a;
      second[i] = worse < c ? worse : c;
      best[i] = a < b ? a : b;
    }
  }
  *least = best[0];
  *second_least = second[0];
}

// Distances<kRows>(tile, row) of kRows query rows from `row` on: Keys(cand, keys) fills keys[kRows]
// with the distances to a vector of candidates, shifted left by key_shift.
template <template <size_t> class Distances, size_t kRows>
COVINZ_INLINE void ScanRows(const MatchTile& tile, size_t row_in_tile) {
  const Distances<kRows> distances(tile, tile.first_row + row_in_tile);
  Lanes best[kRows];
  Lanes second[kRows];
  for (size_t r = 0; r < kRows; ++r) best[r] = second[r] = Lanes{} + kNoKey;
  Lanes indices;
  for (size_t lane = 0; lane < COVINZ_LANES; ++lane) indices[lane] = static_cast<int32_t>(lane);
  for (size_t v = 0; v < tile.num_vectors; ++v, indices += COVINZ_LANES) {
    const size_t cand = (tile.first_vector + v) * COVINZ_LANES;
    Lanes keys[kRows];
    distances.Keys(cand, keys);
    const Lanes beyond = Beyond(tile, cand);
    Lanes column = Load<Lanes>(tile.column_keys + cand);
    int32_t row_index = tile.first_row_index + static_cast<int32_t>(row_in_tile);
    for (size_t r = 0; r < kRows; ++r, ++row_index) {
      const Lanes key = keys[r] | beyond;
      const Lanes row_key = key | indices;
      second[r] = Min(second[r], Max(best[r], row_key));
      best[r] = Min(best[r], row_key);
      column = Min(column, key | row_index);
    }
    Store(tile.column_keys + cand, column);
  }
  for (size_t r = 0; r < kRows; ++r) {
    Reduce(best[r], second[r], tile.best + row_in_tile + r, tile.second + row_in_tile + r);
  }
}

// Rows are taken kRows at a time, which loads the candidates once for all of them.
template <template <size_t> class Distances, size_t kRows>
COVINZ_INLINE void ScanTile(const MatchTile& tile) {
  size_t row = 0;
  for (; row + kRows <= tile.num_rows; row += kRows) ScanRows<Distances, kRows>(tile, row);
  for (; row < tile.num_rows; ++row) ScanRows<Distances, 1>(tile, row);
}

}  // namespace
}  // namespace covinz
