// Keyframes of 128-byte descriptors (SIFT) by visual word, ranked by votes that short codes verify.
#pragma once

#include <cstdint>
#include <vector>

#include "covinz/inverted_index.h"
#include "covinz/vocabulary.h"

namespace covinz {

// The votes of BasicInvertedIndex over codes of 16 bytes: bit i says whether component i of a
// descriptor is above that of its word's centroid. So the index needs an eighth of the descriptors'
// memory, and ranks better than distances of the whole descriptors do: within one word these are
// ruled by few large components.
//
// Not safe for concurrent use while keyframes are added.
//
// Source: decision 0022; Jegou, Douze, Schmid, "Hamming embedding and weak geometric consistency",
// ECCV 2008 (there of random projections, by their medians).
class ResidualIndex {
 public:
  // Bits of 128 in which the codes of one feature may differ: 20 to 32 is a plateau, 40 and more is
  // worse. [decision 0022]
  static constexpr int kDefaultMaxHamming = 28;

  // Throws std::invalid_argument unless 0 <= max_hamming <= 128.
  explicit ResidualIndex(const ByteVocabulary& vocabulary, int max_hamming = kDefaultMaxHamming);

  // Adds a keyframe and returns its index: 0, 1, 2, ... Throws std::invalid_argument where the
  // numbers of words and descriptors differ, or the vocabulary does not have a word.
  uint32_t Add(const std::vector<uint32_t>& words, const std::vector<ByteDescriptor>& descriptors);

  // Votes for each keyframe in the index; throws as Add does.
  std::vector<float> Votes(const std::vector<uint32_t>& words,
                           const std::vector<ByteDescriptor>& descriptors) const;

  uint32_t size() const { return index_.size(); }

 private:
  using Index = BasicInvertedIndex<2>;

  std::vector<Index::Code> Codes(const std::vector<uint32_t>& words,
                                 const std::vector<ByteDescriptor>& descriptors) const;

  std::vector<ByteDescriptor> centroids_;  // by word
  Index index_;
};

}  // namespace covinz
