// Matching kernels of SSE4.2 and POPCNT.
#include "match_kernels.h"

#if defined(__SSE4_2__) && defined(__POPCNT__)

#include <immintrin.h>

#define COVINZ_LANES 4
#include "match_scan.h"

namespace covinz {
namespace {

COVINZ_INLINE UnsignedLanes MultiplyAddHalves(UnsignedLanes a, UnsignedLanes b) {
  return reinterpret_cast<UnsignedLanes>(
      _mm_madd_epi16(reinterpret_cast<__m128i>(a), reinterpret_cast<__m128i>(b)));
}

// Word by word: on 128 bits POPCNT beats looking bytes up.
COVINZ_INLINE uint64_t PopCount(uint64_t x) { return static_cast<uint64_t>(_mm_popcnt_u64(x)); }

COVINZ_INLINE ByteLanes LookUp(ByteLanes table, ByteLanes indices) {
  return reinterpret_cast<ByteLanes>(
      _mm_shuffle_epi8(reinterpret_cast<__m128i>(table), reinterpret_cast<__m128i>(indices)));
}

COVINZ_INLINE ByteLanes BroadcastTable(const uint8_t table[16]) { return Load<ByteLanes>(table); }

COVINZ_INLINE uint64_t LanesUpTo(ByteLanes x, uint8_t most) {
  const __m128i bytes = reinterpret_cast<__m128i>(x);
  const __m128i least = _mm_min_epu8(bytes, _mm_set1_epi8(static_cast<char>(most)));
  return static_cast<uint32_t>(_mm_movemask_epi8(_mm_cmpeq_epi8(least, bytes)));
}

COVINZ_INLINE Lanes ToLanes(const uint64_t bits[COVINZ_LANES]) {
  return reinterpret_cast<Lanes>(_mm_set_epi64x(static_cast<int64_t>(bits[3] << 32 | bits[2]),
                                                static_cast<int64_t>(bits[1] << 32 | bits[0])));
}

template <size_t kRows>
class HammingDistances {
 public:
  HammingDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand.words),
        num_words_(tile.cand.num_groups / 2),
        rows_(tile.query.words + row * num_words_),
        key_shift_(tile.key_shift) {}

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    for (size_t r = 0; r < kRows; ++r) {
      const uint64_t* row = rows_ + r * num_words_;
      const uint64_t* columns = cand_ + cand * num_words_;
      uint64_t bits[COVINZ_LANES] = {};
      for (size_t lane = 0; lane < COVINZ_LANES; ++lane, columns += num_words_) {
        for (size_t w = 0; w < num_words_; ++w) bits[lane] += PopCount(row[w] ^ columns[w]);
      }
      keys[r] = ToLanes(bits) << key_shift_;
    }
  }

 private:
  const uint64_t* cand_;
  size_t num_words_;
  const uint64_t* rows_;
  int key_shift_;
};

}  // namespace
}  // namespace covinz

// Built on the functions above.
#include "match_dot_products_x86.h"
#include "match_lookups.h"

namespace covinz {
const MatchKernels kSse42MatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 1>,
                                         &ScanTile<SquaredDistances, 4>, &FindNearest};
}

#else

namespace covinz {
const MatchKernels kSse42MatchKernels = {0, nullptr, nullptr, nullptr};
}

#endif
