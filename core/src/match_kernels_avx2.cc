// Matching kernels of AVX2.
#include "match_kernels.h"

#if defined(__AVX2__)

#include <immintrin.h>

#define COVINZ_LANES 8
#include "match_scan.h"

namespace covinz {
namespace {

COVINZ_INLINE __m256i LoadVector(const uint32_t* p) {
  return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p));
}

// Set bits of each byte, looked up by half bytes.
COVINZ_INLINE __m256i ByteCounts(__m256i x) {
  const __m256i counts = _mm256_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4,  //
                                          0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4);
  const __m256i low = _mm256_set1_epi8(15);
  return _mm256_add_epi8(
      _mm256_shuffle_epi8(counts, _mm256_and_si256(x, low)),
      _mm256_shuffle_epi8(counts, _mm256_and_si256(_mm256_srli_epi16(x, 4), low)));
}

template <size_t kRows>
class HammingDistances {
 public:
  HammingDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand), rows_(GroupsFrom(tile.query, row)), key_shift_(tile.key_shift) {}

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint32_t* columns = GroupsFrom(cand_, cand);
    for (size_t r = 0; r < kRows; ++r) keys[r] = Lanes{};
    for (size_t step = 0; step < cand_.num_groups; step += kStepGroups) {
      __m256i bytes[kRows];
      for (size_t r = 0; r < kRows; ++r) bytes[r] = _mm256_setzero_si256();
      for (size_t g = 0; g < kStepGroups; ++g) {
        const size_t at = (step + g) * kBlockLanes;
        const __m256i column = LoadVector(columns + at);
        for (size_t r = 0; r < kRows; ++r) {
          const __m256i row = _mm256_set1_epi32(static_cast<int32_t>(rows_[at + r]));
          bytes[r] = _mm256_add_epi8(bytes[r], ByteCounts(_mm256_xor_si256(column, row)));
        }
      }
      for (size_t r = 0; r < kRows; ++r) keys[r] += SumBytes(bytes[r]);
    }
    for (size_t r = 0; r < kRows; ++r) keys[r] = keys[r] << key_shift_;
  }

 private:
  COVINZ_INLINE Lanes SumBytes(__m256i bytes) {
    const __m256i words = _mm256_maddubs_epi16(bytes, _mm256_set1_epi8(1));
    return reinterpret_cast<Lanes>(_mm256_madd_epi16(words, _mm256_set1_epi16(1)));
  }

  PackedView cand_;
  const uint32_t* rows_;
  int key_shift_;
};

// Even and odd bytes as 16-bit integers, whose products are added in pairs without overflow.
struct EvenOdd {
  uint32_t even, odd;
};

// |q - c|^2 = |q|^2 + |c|^2 - 2 q.c.
template <size_t kRows>
class SquaredDistances {
 public:
  SquaredDistances(const MatchTile& tile, size_t row)
      : cand_(tile.cand),
        squared_norms_(tile.query.squared_norms + row),
        key_shift_(tile.key_shift) {
    const uint32_t* rows = GroupsFrom(tile.query, row);
    for (size_t g = 0; g < cand_.num_groups; ++g) {
      for (size_t r = 0; r < kRows; ++r) {
        const uint32_t group = rows[g * kBlockLanes + r];
        rows_[g][r] = {group & 0x00ff00ffu, group >> 8 & 0x00ff00ffu};
      }
    }
  }

  __attribute__((always_inline)) void Keys(size_t cand, Lanes* keys) const {
    const uint32_t* columns = GroupsFrom(cand_, cand);
    __m256i dots[kRows];
    for (size_t r = 0; r < kRows; ++r) dots[r] = _mm256_setzero_si256();
    for (size_t g = 0; g < cand_.num_groups; ++g) {
      const __m256i column = LoadVector(columns + g * kBlockLanes);
      const __m256i even = _mm256_and_si256(column, _mm256_set1_epi16(0xff));
      const __m256i odd = _mm256_srli_epi16(column, 8);
      for (size_t r = 0; r < kRows; ++r) {
        const EvenOdd& row = rows_[g][r];
        dots[r] = _mm256_add_epi32(dots[r], MultiplyAdd(even, row.even));
        dots[r] = _mm256_add_epi32(dots[r], MultiplyAdd(odd, row.odd));
      }
    }
    const UnsignedLanes norms = Load<UnsignedLanes>(cand_.squared_norms + cand);
    for (size_t r = 0; r < kRows; ++r) {
      const UnsignedLanes squared =
          norms + squared_norms_[r] - 2 * reinterpret_cast<UnsignedLanes>(dots[r]);
      keys[r] = reinterpret_cast<Lanes>(squared << key_shift_);
    }
  }

 private:
  COVINZ_INLINE __m256i MultiplyAdd(__m256i columns, uint32_t row) {
    return _mm256_madd_epi16(columns, _mm256_set1_epi32(static_cast<int32_t>(row)));
  }

  PackedView cand_;
  const uint32_t* squared_norms_;
  int key_shift_;
  EvenOdd rows_[kMaxGroups][kRows];
};

}  // namespace

const MatchKernels kAvx2MatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 2>,
                                        &ScanTile<SquaredDistances, 4>};

}  // namespace covinz

#else

namespace covinz {
const MatchKernels kAvx2MatchKernels = {0, nullptr, nullptr};
}

#endif
