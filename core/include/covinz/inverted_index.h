// Keyframes by visual word, ranked by Hamming-verified votes.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "covinz/binary_descriptor.h"

namespace covinz {

// The words only say where to look: a query descriptor votes for a keyframe if that holds,
// under the same word, a descriptor within max_hamming bits. It votes once per keyframe, with
// weight log(number of keyframes / number that it hits): the idf of this very feature, so a
// feature seen everywhere counts nothing.
//
// Not safe for concurrent use while keyframes are added.
//
// Source: decision 0004. Over the same vocabulary these votes find more places than the tf-idf
// score of the paper: benchmarks/place_recognition.py.
class InvertedIndex {
 public:
  // Bits of difference up to which two descriptors show the same feature: 30 to 40 is a
  // plateau, 50 to 60 is worse. [place recognition research]
  static constexpr int kDefaultMaxHamming = 40;

  // Throws std::invalid_argument unless 0 <= max_hamming <= 256.
  explicit InvertedIndex(int max_hamming = kDefaultMaxHamming);

  // Adds a keyframe and returns its index: 0, 1, 2, ... Throws std::invalid_argument where the
  // numbers of words and descriptors differ.
  uint32_t Add(const std::vector<uint32_t>& words,
               const std::vector<BinaryDescriptor>& descriptors);

  // Votes for each keyframe in the index; throws as Add does.
  std::vector<float> Votes(const std::vector<uint32_t>& words,
                           const std::vector<BinaryDescriptor>& descriptors) const;

  uint32_t size() const { return size_; }

 private:
  // Descriptors under one word, in the order of their keyframes.
  struct Postings {
    std::vector<uint32_t> keyframes;
    std::vector<BinaryDescriptor> descriptors;
  };

  int max_hamming_;
  uint32_t size_ = 0;
  std::unordered_map<uint32_t, Postings> postings_;
};

}  // namespace covinz
