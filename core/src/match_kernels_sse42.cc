// Matching kernels of SSE4.2.
#include "match_kernels.h"

#if defined(__SSE4_2__)

#include <immintrin.h>

#define COVINZ_LANES 4
#include "match_scan.h"

namespace covinz {
namespace {

COVINZ_INLINE UnsignedLanes LookUpBytes(const uint8_t table[16], UnsignedLanes indices) {
  const __m128i counts = _mm_loadu_si128(reinterpret_cast<const __m128i*>(table));
  return reinterpret_cast<UnsignedLanes>(
      _mm_shuffle_epi8(counts, reinterpret_cast<__m128i>(indices)));
}

COVINZ_INLINE UnsignedLanes SumBytes(UnsignedLanes bytes) {
  const __m128i halves = _mm_maddubs_epi16(reinterpret_cast<__m128i>(bytes), _mm_set1_epi8(1));
  return reinterpret_cast<UnsignedLanes>(_mm_madd_epi16(halves, _mm_set1_epi16(1)));
}

COVINZ_INLINE UnsignedLanes MultiplyAddHalves(UnsignedLanes a, UnsignedLanes b) {
  return reinterpret_cast<UnsignedLanes>(
      _mm_madd_epi16(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b)));
}

}  // namespace
}  // namespace covinz

// Built on the functions above.
#include "match_distances_x86.h"

namespace covinz {
const MatchKernels kSse42MatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 1>,
                                         &ScanTile<SquaredDistances, 4>};
}

#else

namespace covinz {
const MatchKernels kSse42MatchKernels = {0, nullptr, nullptr};
}

#endif
