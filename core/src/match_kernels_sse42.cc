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
template <size_t kRows>
class HammingDistances {
 public:
  HammingDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand),
        num_words_(tile.cand.num_groups / 2),
        rows_(tile.query.words + row * num_words_),
        key_shift_(tile.key_shift) {}

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint64_t* columns = cand_.words + cand * num_words_;
    for (size_t r = 0; r < kRows; ++r) {
      const uint64_t* row = rows_ + r * num_words_;
      keys[r] =
          Lanes{Distance(row, columns), Distance(row, columns + num_words_),
                Distance(row, columns + 2 * num_words_), Distance(row, columns + 3 * num_words_)}
          << key_shift_;
    }
  }

 private:
  __attribute__((always_inline)) int32_t Distance(const uint64_t* a, const uint64_t* b) const {
    uint64_t bits = 0;
    for (size_t w = 0; w < num_words_; w += kStepGroups / 2) {
      for (size_t i = 0; i < kStepGroups / 2; ++i) bits += PopCount(a[w + i] ^ b[w + i]);
    }
    return static_cast<int32_t>(bits);
  }

  static __attribute__((always_inline)) uint64_t PopCount(uint64_t x) {
    return static_cast<uint64_t>(_mm_popcnt_u64(x));
  }

  PackedView cand_;
  size_t num_words_;
  const uint64_t* rows_;
  int key_shift_;
};

}  // namespace
}  // namespace covinz

// Built on the functions above.
#include "match_dot_products_x86.h"

namespace covinz {
const MatchKernels kSse42MatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 1>,
                                         &ScanTile<SquaredDistances, 4>};
}

#else

namespace covinz {
const MatchKernels kSse42MatchKernels = {0, nullptr, nullptr};
}

#endif
