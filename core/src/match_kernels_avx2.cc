// Matching kernels of AVX2 and POPCNT.
#include "match_kernels.h"

#if defined(__AVX2__) && defined(__POPCNT__)

#include <immintrin.h>

#define COVINZ_LANES 8
#include "match_scan.h"

namespace covinz {
namespace {

COVINZ_INLINE ByteLanes LookUp(ByteLanes table, ByteLanes indices) {
  return reinterpret_cast<ByteLanes>(
      _mm256_shuffle_epi8(reinterpret_cast<__m256i>(table), reinterpret_cast<__m256i>(indices)));
}

COVINZ_INLINE ByteLanes BroadcastTable(const uint8_t table[16]) {
  return reinterpret_cast<ByteLanes>(
      _mm256_broadcastsi128_si256(_mm_loadu_si128(reinterpret_cast<const __m128i*>(table))));
}

COVINZ_INLINE uint64_t LanesUpTo(ByteLanes x, uint8_t most) {
  const __m256i bytes = reinterpret_cast<__m256i>(x);
  const __m256i least = _mm256_min_epu8(bytes, _mm256_set1_epi8(static_cast<char>(most)));
  return static_cast<uint32_t>(_mm256_movemask_epi8(_mm256_cmpeq_epi8(least, bytes)));
}

COVINZ_INLINE uint64_t PopCount(uint64_t x) { return static_cast<uint64_t>(_mm_popcnt_u64(x)); }

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
  const ByteLanes table = BroadcastTable(counts);
  const ByteLanes low = LookUp(table, reinterpret_cast<ByteLanes>(x & 0x0f0f0f0fu));
  const ByteLanes high = LookUp(table, reinterpret_cast<ByteLanes>(x >> 4 & 0x0f0f0f0fu));
  return reinterpret_cast<UnsignedLanes>(low + high);
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
#include "match_lookups.h"

namespace covinz {
const MatchKernels kAvx2MatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 1>,
                                        &ScanTile<SquaredDistances, 4>, &FindNearest};
}

#else

namespace covinz {
const MatchKernels kAvx2MatchKernels = {0, nullptr, nullptr, nullptr};
}

#endif
