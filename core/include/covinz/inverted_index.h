// Keyframes by visual word, ranked by Hamming-verified votes.
#pragma once

#include <array>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "covinz/binary_descriptor.h"

namespace covinz {

// The words only say where to look: a query descriptor votes for a keyframe if that holds,
// under the same word, a descriptor whose code of 64 * kWords bits is within max_hamming bits. The
// code of a binary descriptor is the descriptor; ResidualIndex makes those of others. It votes once
// per keyframe, with weight log(number of keyframes / number that it hits): the idf of this very
// feature, so a feature seen everywhere counts nothing.
//
// Not safe for concurrent use while keyframes are added.
//
// Source: decision 0004. Over the same vocabulary these votes find more places than the tf-idf
// score of the paper: benchmarks/place_recognition.py.
template <size_t kWords>
class BasicInvertedIndex {
 public:
  using Code = std::array<uint64_t, kWords>;

  // Throws std::invalid_argument unless 0 <= max_hamming <= 64 * kWords.
  explicit BasicInvertedIndex(int max_hamming);

  // Adds a keyframe and returns its index: 0, 1, 2, ... Throws std::invalid_argument where the
  // numbers of words and codes differ.
  uint32_t Add(const std::vector<uint32_t>& words, const std::vector<Code>& codes);

  // Votes for each keyframe in the index; throws as Add does.
  std::vector<float> Votes(const std::vector<uint32_t>& words,
                           const std::vector<Code>& codes) const;

  uint32_t size() const { return size_; }

 private:
  // Codes under one word, in the order of their keyframes.
  struct Postings {
    std::vector<uint32_t> keyframes;
    std::vector<Code> codes;
  };

  int max_hamming_;
  uint32_t size_ = 0;
  std::unordered_map<uint32_t, Postings> postings_;
};

// Of 256-bit descriptors.
class InvertedIndex : public BasicInvertedIndex<4> {
 public:
  // Bits of difference up to which two descriptors show the same feature: 30 to 40 is a
  // plateau, 50 to 60 is worse. [place recognition research]
  static constexpr int kDefaultMaxHamming = 40;

  explicit InvertedIndex(int max_hamming = kDefaultMaxHamming) : BasicInvertedIndex(max_hamming) {}
};

extern template class BasicInvertedIndex<2>;
extern template class BasicInvertedIndex<4>;

}  // namespace covinz
