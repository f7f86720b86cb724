// Matching kernels for any processor, in the compiler's vectors of four.
#include "match_kernels.h"

#define COVINZ_LANES 4
#include "match_scan.h"

namespace covinz {
namespace {

// One bit of each position's count of three.
COVINZ_INLINE UnsignedLanes AddBits(UnsignedLanes a,
                                    UnsignedLanes b,
                                    UnsignedLanes c,
                                    UnsignedLanes* carry) {
  const UnsignedLanes either = a ^ b;
  *carry = (a & b) | (either & c);
  return either ^ c;
}

COVINZ_INLINE UnsignedLanes Fours(UnsignedLanes x) {
  return (x & 0x33333333u) + (x >> 2 & 0x33333333u);
}

// Of bits worth one and bits worth two, the sum of every four positions.
COVINZ_INLINE UnsignedLanes SumFours(UnsignedLanes ones, UnsignedLanes twos) {
  const UnsignedLanes even = (ones & 0x55555555u) | (twos & 0x55555555u) << 1;
  const UnsignedLanes odd = (ones >> 1 & 0x55555555u) | (twos & 0xaaaaaaaau);
  return Fours(even) + Fours(odd);
}

COVINZ_INLINE UnsignedLanes Bytes(UnsignedLanes fours) {
  return (fours & 0x0f0f0f0fu) + (fours >> 4 & 0x0f0f0f0fu);
}

// Set bits of eight groups: they are added bit by bit (Harley and Seal) before they are counted.
COVINZ_INLINE UnsignedLanes CountBits(const UnsignedLanes x[kStepGroups]) {
  UnsignedLanes carry[4];
  UnsignedLanes fours[2];
  const UnsignedLanes zero = {};
  UnsignedLanes ones = AddBits(x[0], x[1], x[2], &carry[0]);
  ones = AddBits(ones, x[3], x[4], &carry[1]);
  ones = AddBits(ones, x[5], x[6], &carry[2]);
  ones = AddBits(ones, x[7], zero, &carry[3]);
  UnsignedLanes twos = AddBits(carry[0], carry[1], carry[2], &fours[0]);
  twos = AddBits(twos, carry[3], zero, &fours[1]);
  const UnsignedLanes of_one = SumFours(ones, twos);
  const UnsignedLanes of_four = SumFours(fours[0] ^ fours[1], fours[0] & fours[1]);
  UnsignedLanes count = Bytes(of_one) + (Bytes(of_four) << 2);
  count = (count + (count >> 8)) & 0x00ff00ffu;  // a byte counts at most 64 bits
  return (count + (count >> 16)) & 0xffffu;
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
        UnsignedLanes differing[kStepGroups];
        for (size_t g = 0; g < kStepGroups; ++g) {
          const size_t at = (step + g) * kBlockLanes;
          differing[g] = Load<UnsignedLanes>(columns + at) ^ rows_[at + r];
        }
        bits += CountBits(differing);
      }
      keys[r] = reinterpret_cast<Lanes>(bits << key_shift_);
    }
  }

 private:
  PackedView cand_;
  const uint32_t* rows_;
  int key_shift_;
};

typedef uint16_t HalfLanes __attribute__((vector_size(4 * COVINZ_LANES)));

// |q - c|^2 = |q|^2 + |c|^2 - 2 q.c; products of two bytes fit 16 bits.
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
    UnsignedLanes dots[kRows] = {};
    for (size_t g = 0; g < cand_.num_groups; ++g) {
      const HalfLanes column = Load<HalfLanes>(columns + g * kBlockLanes);
      for (size_t r = 0; r < kRows; ++r) {
        const HalfLanes row = reinterpret_cast<HalfLanes>(Broadcast(rows_[g * kBlockLanes + r]));
        dots[r] += SumPairs((column & 0xff) * (row & 0xff)) + SumPairs((column >> 8) * (row >> 8));
      }
    }
    const UnsignedLanes norms = Load<UnsignedLanes>(cand_.squared_norms + cand);
    for (size_t r = 0; r < kRows; ++r) {
      const UnsignedLanes squared = norms + squared_norms_[r] - 2 * dots[r];
      keys[r] = reinterpret_cast<Lanes>(squared << key_shift_);
    }
  }

 private:
  COVINZ_INLINE UnsignedLanes SumPairs(HalfLanes halves) {
    const UnsignedLanes pairs = reinterpret_cast<UnsignedLanes>(halves);
    return (pairs & 0xffffu) + (pairs >> 16);
  }

  PackedView cand_;
  const uint32_t* rows_;
  const uint32_t* squared_norms_;
  int key_shift_;
};

}  // namespace

const MatchKernels kPortableMatchKernels = {COVINZ_LANES, &ScanTile<HammingDistances, 2>,
                                            &ScanTile<SquaredDistances, 4>, nullptr};

}  // namespace covinz
