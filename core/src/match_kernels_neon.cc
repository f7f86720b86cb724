// Matching kernels of 64-bit ARM.
#include "match_kernels.h"

#if defined(__aarch64__)

#include <arm_neon.h>

#define COVINZ_LANES 4
#include "match_scan.h"

namespace covinz {
namespace {

template <size_t kRows>
class HammingDistances {
 public:
  HammingDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand), rows_(GroupsFrom(tile.query, row)), key_shift_(tile.key_shift) {}

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint32_t* columns = GroupsFrom(cand_, cand);
    for (size_t r = 0; r < kRows; ++r) keys[r] = Lanes{};
    for (size_t step = 0; step < cand_.num_groups; step += kStepGroups) {
      uint8x16_t bytes[kRows];
      for (size_t r = 0; r < kRows; ++r) bytes[r] = vdupq_n_u8(0);
      for (size_t g = 0; g < kStepGroups; ++g) {
        const size_t at = (step + g) * kBlockLanes;
        const uint32x4_t column = vld1q_u32(columns + at);
        for (size_t r = 0; r < kRows; ++r) {
          const uint32x4_t differing = veorq_u32(column, vdupq_n_u32(rows_[at + r]));
          bytes[r] = vaddq_u8(bytes[r], vcntq_u8(vreinterpretq_u8_u32(differing)));
        }
      }
      for (size_t r = 0; r < kRows; ++r) {
        keys[r] += reinterpret_cast<Lanes>(vpaddlq_u16(vpaddlq_u8(bytes[r])));
      }
    }
    for (size_t r = 0; r < kRows; ++r) keys[r] = keys[r] << key_shift_;
  }

 private:
  PackedView cand_;
  const uint32_t* rows_;
  int key_shift_;
};

// |q - c|^2 = |q|^2 + |c|^2 - 2 q.c.
template <size_t kRows>
class SquaredDistances {
 public:
  SquaredDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand),
        rows_(GroupsFrom(tile.query, row)),
        squared_norms_(tile.query.squared_norms + row),
        key_shift_(tile.key_shift) {}

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint32_t* columns = GroupsFrom(cand_, cand);
    uint32x4_t low[kRows];   // the two halves of the dot products of candidates 0 and 1 ...
    uint32x4_t high[kRows];  // ... and of 2 and 3
    for (size_t r = 0; r < kRows; ++r) low[r] = high[r] = vdupq_n_u32(0);
    for (size_t g = 0; g < cand_.num_groups; ++g) {
      const uint8x16_t column = vreinterpretq_u8_u32(vld1q_u32(columns + g * kBlockLanes));
      for (size_t r = 0; r < kRows; ++r) {
        const uint8x16_t row = vreinterpretq_u8_u32(vdupq_n_u32(rows_[g * kBlockLanes + r]));
        low[r] = vpadalq_u16(low[r], vmull_u8(vget_low_u8(column), vget_low_u8(row)));
        high[r] = vpadalq_u16(high[r], vmull_high_u8(column, row));
      }
    }
    const UnsignedLanes norms = Load<UnsignedLanes>(cand_.squared_norms + cand);
    for (size_t r = 0; r < kRows; ++r) {
      const UnsignedLanes dots = reinterpret_cast<UnsignedLanes>(vpaddq_u32(low[r], high[r]));
      keys[r] = reinterpret_cast<Lanes>((norms + squared_norms_[r] - 2 * dots) << key_shift_);
    }
  }

 private:
  PackedView cand_;
  const uint32_t* rows_;
  const uint32_t* squared_norms_;
  int key_shift_;
};

}  // namespace

const MatchKernels kNeonMatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 4>,
                                        &ScanTile<SquaredDistances, 4>, nullptr};

}  // namespace covinz

#else

namespace covinz {
const MatchKernels kNeonMatchKernels = {0, nullptr, nullptr, nullptr};
}

#endif
