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

// Of 256 bits, the row in registers.
template <size_t kRows>
class ShortHammingDistances {
 public:
  ShortHammingDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand.words), key_shift_(tile.key_shift) {
    static_assert(kRows == 1, "one row fills the registers");
    for (size_t w = 0; w < kWords; ++w) row_[w] = tile.query.words[kWords * row + w];
  }

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint64_t* c = cand_ + kWords * cand;
    const uint64_t bits[COVINZ_LANES] = {Distance(c), Distance(c + kWords),
                                         Distance(c + 2 * kWords), Distance(c + 3 * kWords)};
    keys[0] = ToLanes(bits) << key_shift_;
  }

 private:
  static constexpr size_t kWords = kStepGroups / 2;

  __attribute__((always_inline)) uint64_t Distance(const uint64_t* c) const {
    return (PopCount(row_[0] ^ c[0]) + PopCount(row_[1] ^ c[1])) +
           (PopCount(row_[2] ^ c[2]) + PopCount(row_[3] ^ c[3]));
  }

  const uint64_t* cand_;
  int key_shift_;
  uint64_t row_[kWords];
};

void ScanHamming(const MatchTile& tile) {
  if (tile.cand.num_groups == kStepGroups) {
    ScanTile<ShortHammingDistances, 1>(tile);
  } else {
    ScanTile<HammingDistances, 1>(tile);
  }
}

}  // namespace
}  // namespace covinz

// Built on the functions above.
#include "match_dot_products_x86.h"

namespace covinz {
const MatchKernels kSse42MatchKernels = {COVINZ_LANES, &ScanHamming,
                                         &ScanTile<SquaredDistances, 4>};
}

#else

namespace covinz {
const MatchKernels kSse42MatchKernels = {0, nullptr, nullptr};
}

#endif
