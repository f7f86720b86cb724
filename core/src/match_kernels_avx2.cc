// Matching kernels of AVX2.
#include "match_kernels.h"

#if defined(__AVX2__)

#include <immintrin.h>

#define COVINZ_LANES 8
#include "match_scan.h"

namespace covinz {
namespace {

COVINZ_INLINE UnsignedLanes LookUpBytes(const uint8_t table[16], UnsignedLanes indices) {
  const __m256i counts =
      _mm256_broadcastsi128_si256(_mm_loadu_si128(reinterpret_cast<const __m128i*>(table)));
  return reinterpret_cast<UnsignedLanes>(
      _mm256_shuffle_epi8(counts, reinterpret_cast<__m256i>(indices)));
}

COVINZ_INLINE UnsignedLanes SumBytes(UnsignedLanes bytes) {
  const __m256i halves =
      _mm256_maddubs_epi16(reinterpret_cast<__m256i>(bytes), _mm256_set1_epi8(1));
  return reinterpret_cast<UnsignedLanes>(_mm256_madd_epi16(halves, _mm256_set1_epi16(1)));
}

COVINZ_INLINE UnsignedLanes MultiplyAddHalves(UnsignedLanes a, UnsignedLanes b) {
  return reinterpret_cast<UnsignedLanes>(
      _mm256_madd_epi16(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b)));
}

// Set bits of each byte, looked up by half bytes.
COVINZ_INLINE UnsignedLanes ByteCounts(UnsignedLanes x) {
  const uint8_t counts[16] = {0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4};
  // No byte overflows, so whole groups may be added.
  return LookUpBytes(counts, x & 0x0f0f0f0fu) + LookUpBytes(counts, x >> 4 & 0x0f0f0f0fu);
}

template <size_t kRows>
class HammingDistances {
 public:
  HammingDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand), rows_(GroupsFrom(tile.query, row)), key_shift_(tile.key_shift) {}

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint32_t* columns = GroupsFrom(cand_, cand);
    for (size_t r = 0; r < kRows; ++r) {
      UnsignedLanes bits = {};
      for (size_t step = 0; step < cand_.num_groups; step += kStepGroups) {
        UnsignedLanes bytes = {};
        for (size_t g = 0; g < kStepGroups; ++g) {
          const size_t at = (step + g) * kBlockLanes;
          bytes += ByteCounts(Load<UnsignedLanes>(columns + at) ^ rows_[at + r]);
        }
        bits += SumBytes(bytes);
      }
      keys[r] = reinterpret_cast<Lanes>(bits << key_shift_);
    }
  }

 private:
  PackedView cand_;
  const uint32_t* rows_;
  int key_shift_;
};

}  // namespace
}  // namespace covinz

// Built on the functions above.
#include "match_dot_products_x86.h"

namespace covinz {
const MatchKernels kAvx2MatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 1>,
                                        &ScanTile<SquaredDistances, 4>};
}

#else

namespace covinz {
const MatchKernels kAvx2MatchKernels = {0, nullptr, nullptr};
}

#endif
