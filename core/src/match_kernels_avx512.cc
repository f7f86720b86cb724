// Matching kernels of AVX-512 with VPOPCNTDQ and VNNI.
#include "match_kernels.h"

#if defined(__AVX512VPOPCNTDQ__) && defined(__AVX512VNNI__)

#include <immintrin.h>

#define COVINZ_LANES 16
#include "match_scan.h"

namespace covinz {
namespace {

COVINZ_INLINE __m512i Broadcast512(uint32_t value) {
  return _mm512_set1_epi32(static_cast<int32_t>(value));
}

template <size_t kRows>
class HammingDistances {
 public:
  HammingDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand), rows_(GroupsFrom(tile.query, row)), key_shift_(tile.key_shift) {}

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint32_t* columns = GroupsFrom(cand_, cand);
    __m512i bits[kRows];
    for (size_t r = 0; r < kRows; ++r) bits[r] = _mm512_setzero_si512();
    for (size_t step = 0; step < cand_.num_groups; step += kStepGroups) {
      for (size_t g = 0; g < kStepGroups; ++g) {
        const size_t at = (step + g) * kBlockLanes;
        const __m512i column = _mm512_loadu_si512(columns + at);
        for (size_t r = 0; r < kRows; ++r) {
          const __m512i differing = _mm512_xor_si512(column, Broadcast512(rows_[at + r]));
          bits[r] = _mm512_add_epi32(bits[r], _mm512_popcnt_epi32(differing));
        }
      }
    }
    for (size_t r = 0; r < kRows; ++r) keys[r] = reinterpret_cast<Lanes>(bits[r]) << key_shift_;
  }

 private:
  PackedView cand_;
  const uint32_t* rows_;
  int key_shift_;
};

// |q - c|^2 = |q|^2 + |c|^2 - 2 q.c, where VNNI multiplies unsigned with signed bytes:
// q.c = q.(c - 128) + 128 sum(q). All modulo 2^32.
template <size_t kRows>
class SquaredDistances {
 public:
  SquaredDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand),
        rows_(GroupsFrom(tile.query, row)),
        sums_(tile.query.sums + row),
        squared_norms_(tile.query.squared_norms + row),
        key_shift_(tile.key_shift) {}

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint32_t* columns = GroupsFrom(cand_, cand);
    const __m512i to_signed = Broadcast512(0x80808080u);
    __m512i dots[kRows];
    for (size_t r = 0; r < kRows; ++r) dots[r] = _mm512_setzero_si512();
    for (size_t g = 0; g < cand_.num_groups; ++g) {
      const size_t at = g * kBlockLanes;
      const __m512i column = _mm512_xor_si512(_mm512_loadu_si512(columns + at), to_signed);
      for (size_t r = 0; r < kRows; ++r) {
        dots[r] = _mm512_dpbusd_epi32(dots[r], Broadcast512(rows_[at + r]), column);
      }
    }
    const UnsignedLanes norms = Load<UnsignedLanes>(cand_.squared_norms + cand);
    for (size_t r = 0; r < kRows; ++r) {
      const UnsignedLanes squared = norms + (squared_norms_[r] - 256 * sums_[r]) -
                                    2 * reinterpret_cast<UnsignedLanes>(dots[r]);
      keys[r] = reinterpret_cast<Lanes>(squared << key_shift_);
    }
  }

 private:
  PackedView cand_;
  const uint32_t* rows_;
  const uint32_t* sums_;
  const uint32_t* squared_norms_;
  int key_shift_;
};

}  // namespace

const MatchKernels kAvx512MatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 4>,
                                          &ScanTile<SquaredDistances, 8>, nullptr};

}  // namespace covinz

#else

namespace covinz {
const MatchKernels kAvx512MatchKernels = {0, nullptr, nullptr, nullptr};
}

#endif
