// The inner loops of MatchPacked, one version per instruction set.
//
// Each match_kernels_*.cc but the portable one is compiled with flags of its own (CMakeLists.txt).
// So that none of its code is run by mistake on other processors, it defines nothing that the
// linker could share: it includes no library headers with inline functions, nor Eigen, and takes
// plain pointers.
#pragma once

#include <cstddef>
#include <cstdint>

namespace covinz {

// Largest key; no distance.
inline constexpr int32_t kNoKey = INT32_MAX;
inline constexpr size_t kMaxTileRows = 8;

// PackedDescriptors as the kernels read them.
struct PackedView {
  const uint32_t* groups;
  const uint64_t* words;
  const uint32_t* sums;
  const uint32_t* squared_norms;
  size_t num_groups;
  size_t size;
};

// A few query rows against a run of candidates. A key is a distance (squared for L2), shifted left
// by key_shift, plus an index below 2^key_shift: the least key is the nearest and the first of
// equals.
struct MatchTile {
  PackedView query;
  PackedView cand;
  size_t first_row;
  size_t num_rows;      // at most kMaxTileRows
  size_t first_vector;  // a vector is as many candidates as the kernel has lanes
  size_t num_vectors;   // the last may go beyond the candidates
  int key_shift;
  int32_t first_row_index;  // index of first_row in column_keys
  // Least key of each candidate so far, its index the query row; updated.
  int32_t* column_keys;
  // Least and second least key of each row, its index the candidate, 0 for the first one of
  // first_vector; written.
  int32_t* best;
  int32_t* second;
};

// Descriptors of 256 bits, nibble by nibble: nibble 8 g + n of descriptor 64 b + i is at
// [((g * num_padded / 64 + b) * 8 + n) * 64 + i].
struct NibbleView {
  const uint8_t* nibbles;  // at a multiple of 64 bytes
  size_t num_padded;       // a multiple of 64
  const uint64_t* words;   // the same descriptors, 4 words each
  size_t size;
};
inline constexpr size_t kNibbleBlock = 64;

// A few descriptors, each of which looks for its nearest one.
struct NearestTile {
  NibbleView others;
  size_t num_rows;  // at most kMaxTileRows
  const uint64_t* rows[kMaxTileRows];
  // Looked for are distances up to this, 256 at most.
  int32_t max_distances[kMaxTileRows];
  // A row whose nearest is at distance d has none if another is at spoilers[d] or nearer; null for
  // no such rule.
  const int32_t* spoilers;
  // Of the 8 groups of 32 bits, those which make the lower bound. They decide on time alone.
  size_t num_bound_groups;
  uint8_t* bounds;  // room for kMaxTileRows * num_padded, at a multiple of 64 bytes
  // Written, the indices kNoIndex where there is none.
  int32_t distances[kMaxTileRows];
  size_t indices[kMaxTileRows];
  size_t num_verified;  // distances that the bounds did not save
};
inline constexpr size_t kNoIndex = SIZE_MAX;

struct MatchKernels {
  size_t num_lanes;
  void (*hamming)(const MatchTile&);
  void (*l2)(const MatchTile&);
  void (*nearest)(NearestTile*);  // null where `hamming` is no slower
};

// Without kernels (num_lanes 0) where the build's processor family has no such instruction set.
extern const MatchKernels kPortableMatchKernels;
extern const MatchKernels kNeonMatchKernels;
extern const MatchKernels kSse42MatchKernels;
extern const MatchKernels kAvx2MatchKernels;
extern const MatchKernels kAvx512MatchKernels;

}  // namespace covinz
