// Distances of numbers by the instructions that SSE4.2 and AVX2 share. The file that includes this
// defines, on its vectors of COVINZ_LANES groups, MultiplyAddHalves: the dot product of each
// group's two 16-bit integers. All here is internal to that file.
#pragma once

#include "match_scan.h"

namespace covinz {
namespace {

// Even and odd bytes as 16-bit integers, whose products are added in pairs without overflow.
struct EvenOdd {
  uint32_t even, odd;
};

// |q - c|^2 = |q|^2 + |c|^2 - 2 q.c.
template <size_t kRows>
class SquaredDistances {
 public:
  SquaredDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand),
        squared_norms_(tile.query.squared_norms + row),
        key_shift_(tile.key_shift) {
    const uint32_t* rows = GroupsFrom(tile.query, row);
    for (size_t g = 0; g < cand_.num_groups; ++g) {
      for (size_t r = 0; r < kRows; ++r) {
        const uint32_t group = rows[g * kBlockLanes + r];
        rows_[g][r] = {group & 0x00ff00ffu, group >> 8 & 0x00ff00ffu};
      }
    }
  }

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint32_t* columns = GroupsFrom(cand_, cand);
    UnsignedLanes dots[kRows] = {};
    for (size_t g = 0; g < cand_.num_groups; ++g) {
      const UnsignedLanes column = Load<UnsignedLanes>(columns + g * kBlockLanes);
      const UnsignedLanes even = column & 0x00ff00ffu;
      const UnsignedLanes odd = column >> 8 & 0x00ff00ffu;
      for (size_t r = 0; r < kRows; ++r) {
        dots[r] += MultiplyAddHalves(even, Broadcast(rows_[g][r].even));
        dots[r] += MultiplyAddHalves(odd, Broadcast(rows_[g][r].odd));
      }
    }
    const UnsignedLanes norms = Load<UnsignedLanes>(cand_.squared_norms + cand);
    for (size_t r = 0; r < kRows; ++r) {
      const UnsignedLanes squared = norms + squared_norms_[r] - 2 * dots[r];
      keys[r] = reinterpret_cast<Lanes>(squared << key_shift_);
    }
  }

 private:
  PackedView cand_;
  const uint32_t* squared_norms_;
  int key_shift_;
  EvenOdd rows_[kMaxGroups][kRows];
};

}  // namespace
}  // namespace covinz
