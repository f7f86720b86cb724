// Keyframes by visual word, ranked by the similarity of their bags of words.
#pragma once

#include <cstdint>
#include <vector>

#include "covinz/vocabulary.h"

namespace covinz {

// The paper's score. A bag of words v holds, per word, the number of its features times the
// word's idf, and sums to one; the score of two bags is 1 - |v - w|_1 / 2, from 0 (no common
// word) to 1 (equal).
//
// Not safe for concurrent use while keyframes are added.
//
// Source: COVINS-G, III-A; Galvez-Lopez and Tardos, "Bags of binary words for fast place
// recognition in image sequences", T-RO 2012, eq. (2).
class TfIdfIndex {
 public:
  template <typename Descriptor>
  explicit TfIdfIndex(const BasicVocabulary<Descriptor>& vocabulary)
      : idf_(vocabulary.idf()), postings_(vocabulary.num_words()) {}

  // Adds a keyframe and returns its index: 0, 1, 2, ... Throws std::invalid_argument on a word
  // that the vocabulary does not have.
  uint32_t Add(const std::vector<uint32_t>& words);

  // Score of each keyframe in the index; throws as Add does.
  std::vector<float> Scores(const std::vector<uint32_t>& words) const;

  uint32_t size() const { return size_; }

 private:
  struct Posting {
    uint32_t keyframe;
    double weight;  // share of the word in the keyframe's bag
  };
  struct WeightedWord {
    uint32_t word;
    double weight;
  };

  std::vector<WeightedWord> BagOf(std::vector<uint32_t> words) const;

  std::vector<float> idf_;
  std::vector<std::vector<Posting>> postings_;  // by word
  uint32_t size_ = 0;
};

}  // namespace covinz
