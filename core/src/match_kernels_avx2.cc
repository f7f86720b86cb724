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

}  // namespace
}  // namespace covinz

// Built on the functions above.
#include "match_distances_x86.h"

namespace covinz {
const MatchKernels kAvx2MatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 1>,
                                        &ScanTile<SquaredDistances, 4>};
}

#else

namespace covinz {
const MatchKernels kAvx2MatchKernels = {0, nullptr, nullptr};
}

#endif
