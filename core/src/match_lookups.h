// Nearest neighbours among descriptors of 256 bits, for instruction sets that look up bytes in
// registers faster than they count bits. The distances of one nibble to all values of another are a
// table of sixteen bytes, so one look-up is four bits of the distances of as many descriptors as a
// vector has bytes. Some of the nibbles give a lower bound of each distance; only the few that it
// leaves open are computed.
//
// The file that includes this defines LookUp, BroadcastTable, LanesUpTo (one bit a byte) and
// PopCount. All here is internal to that file.
//
// Source: Andre, Kermarrec, Le Scouarnec, "Cache locality is not enough: high-performance nearest
// neighbor search with product quantization fast scan", PVLDB 2015 (tables in registers, bounds).
#pragma once

#include "match_scan.h"

namespace covinz {
namespace {

constexpr size_t kVectorBytes = sizeof(ByteLanes);
constexpr size_t kGroupNibbles = 8;

// Bits in which two nibbles differ.
struct NibbleDistances {
  uint8_t table[16][16];
};

constexpr NibbleDistances MakeNibbleDistances() {
  NibbleDistances distances{};
  for (unsigned a = 0; a < 16; ++a) {
    for (unsigned b = 0; b < 16; ++b) {
      const unsigned x = a ^ b;
      distances.table[a][b] =
          static_cast<uint8_t>((x & 1u) + (x >> 1 & 1u) + (x >> 2 & 1u) + (x >> 3));
    }
  }
  return distances;
}

constexpr NibbleDistances kNibbleDistances = MakeNibbleDistances();

COVINZ_INLINE ByteLanes LoadAligned(const uint8_t* p) {
  return Load<ByteLanes>(static_cast<const uint8_t*>(__builtin_assume_aligned(p, kVectorBytes)));
}

COVINZ_INLINE void StoreAligned(uint8_t* p, ByteLanes bytes) {
  __builtin_memcpy(__builtin_assume_aligned(p, kVectorBytes), &bytes, sizeof(bytes));
}

// Adds one group's part of the distances of a row to its bounds; they stay below 256 but for
// distances of 256 themselves, which become 0.
template <bool kFirst>
COVINZ_INLINE void AddGroup(const NibbleView& others,
                            const uint64_t* row,
                            size_t group,
                            uint8_t* bounds) {
  const uint32_t bits = static_cast<uint32_t>(row[group / 2] >> (32 * (group % 2)));
  ByteLanes tables[kGroupNibbles];
  for (size_t n = 0; n < kGroupNibbles; ++n) {
    tables[n] = BroadcastTable(kNibbleDistances.table[bits >> (4 * n) & 15u]);
  }
  const size_t num_padded = others.num_padded;
  const uint8_t* nibbles = others.nibbles + group * kGroupNibbles * num_padded;
  for (size_t block = 0; block < num_padded; block += kNibbleBlock) {
    for (size_t i = 0; i < kNibbleBlock; i += kVectorBytes) {
      ByteLanes parts[kGroupNibbles];
      for (size_t n = 0; n < kGroupNibbles; ++n) {
        parts[n] = LookUp(tables[n], LoadAligned(nibbles + n * kNibbleBlock + i));
      }
      const ByteLanes sum = ((parts[0] + parts[1]) + (parts[2] + parts[3])) +
                            ((parts[4] + parts[5]) + (parts[6] + parts[7]));
      uint8_t* bound = bounds + block + i;
      StoreAligned(bound, kFirst ? sum : LoadAligned(bound) + sum);
    }
    nibbles += kGroupNibbles * kNibbleBlock;
  }
}

COVINZ_INLINE int32_t WordsDistance(const uint64_t* a, const uint64_t* b) {
  return static_cast<int32_t>((PopCount(a[0] ^ b[0]) + PopCount(a[1] ^ b[1])) +
                              (PopCount(a[2] ^ b[2]) + PopCount(a[3] ^ b[3])));
}

// Goes through the descriptors, in order, that the bounds leave within a distance.
class Candidates {
 public:
  Candidates(const NearestTile& tile, size_t row)
      : others_(tile.others),
        row_(tile.rows[row]),
        bounds_(tile.bounds + row * tile.others.num_padded) {}

  // The next one at most so far away; its distance, or -1 at the end.
  __attribute__((always_inline)) int32_t Next(int32_t most) {
    for (;;) {
      while (open_ != 0) {
        index_ = first_ + static_cast<size_t>(__builtin_ctzll(open_));
        open_ &= open_ - 1;
        if (index_ >= others_.size) continue;
        ++num_verified_;
        const int32_t distance = WordsDistance(row_, others_.words + 4 * index_);
        if (distance <= most) return distance;
      }
      if (next_ == others_.num_padded) return -1;
      first_ = next_;
      next_ += kVectorBytes;
      open_ =
          LanesUpTo(LoadAligned(bounds_ + first_), static_cast<uint8_t>(most < 255 ? most : 255));
    }
  }

  size_t index() const { return index_; }
  size_t num_verified() const { return num_verified_; }

 private:
  const NibbleView& others_;
  const uint64_t* row_;
  const uint8_t* bounds_;
  size_t next_ = 0;
  size_t first_ = 0;
  uint64_t open_ = 0;
  size_t index_ = 0;
  size_t num_verified_ = 0;
};

// The first of the nearest ones.
COVINZ_INLINE void TakeNearest(NearestTile* tile, size_t row) {
  tile->indices[row] = kNoIndex;
  Candidates candidates(*tile, row);
  int32_t most = tile->max_distances[row];
  while (most >= 0) {
    const int32_t distance = candidates.Next(most);
    if (distance < 0) break;
    tile->distances[row] = distance;
    tile->indices[row] = candidates.index();
    most = distance - 1;
  }
  tile->num_verified += candidates.num_verified();
}

COVINZ_INLINE void DropSpoilt(NearestTile* tile, size_t row) {
  const size_t nearest = tile->indices[row];
  if (nearest == kNoIndex || tile->spoilers == nullptr) return;
  Candidates candidates(*tile, row);
  const int32_t most = tile->spoilers[tile->distances[row]];
  while (candidates.Next(most) >= 0) {
    if (candidates.index() == nearest) continue;
    tile->indices[row] = kNoIndex;
    break;
  }
  tile->num_verified += candidates.num_verified();
}

// Group by group, so that the nibbles of one stay in the cache for all rows.
void FindNearest(NearestTile* tile) {
  for (size_t group = 0; group < tile->num_bound_groups; ++group) {
    for (size_t row = 0; row < tile->num_rows; ++row) {
      uint8_t* bounds = tile->bounds + row * tile->others.num_padded;
      if (group == 0) {
        AddGroup<true>(tile->others, tile->rows[row], group, bounds);
      } else {
        AddGroup<false>(tile->others, tile->rows[row], group, bounds);
      }
    }
  }
  tile->num_verified = 0;
  for (size_t row = 0; row < tile->num_rows; ++row) {
    TakeNearest(tile, row);
    DropSpoilt(tile, row);
  }
}

}  // namespace
}  // namespace covinz
