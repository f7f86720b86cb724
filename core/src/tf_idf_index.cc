// Bags of words and their L1 score.
#include "covinz/tf_idf_index.h"

#include <algorithm>
#include <stdexcept>

namespace covinz {

std::vector<TfIdfIndex::WeightedWord> TfIdfIndex::BagOf(std::vector<uint32_t> words) const {
  std::sort(words.begin(), words.end());
  if (!words.empty() && words.back() >= idf_.size()) {
    throw std::invalid_argument("Tf-idf index: a word is not in the vocabulary");
  }
  std::vector<WeightedWord> bag;
  double sum = 0.0;
  for (const uint32_t word : words) {
    const double weight = static_cast<double>(idf_[word]);
    if (weight == 0.0) continue;  // in every training image: says nothing
    if (bag.empty() || bag.back().word != word) bag.push_back({word, 0.0});
    bag.back().weight += weight;
    sum += weight;
  }
  for (WeightedWord& entry : bag) entry.weight /= sum;
  return bag;
}

uint32_t TfIdfIndex::Add(const std::vector<uint32_t>& words) {
  for (const WeightedWord& entry : BagOf(words)) {
    postings_[entry.word].push_back({size_, entry.weight});
  }
  return size_++;
}

std::vector<float> TfIdfIndex::Scores(const std::vector<uint32_t>& words) const {
  // Both bags sum to one, so 1 - |v - w|_1 / 2 is the sum of min(v, w) over the common words.
  std::vector<double> scores(size_, 0.0);
  for (const WeightedWord& entry : BagOf(words)) {
    for (const Posting& posting : postings_[entry.word]) {
      scores[posting.keyframe] += std::min(entry.weight, posting.weight);
    }
  }
  return std::vector<float>(scores.begin(), scores.end());
}

}  // namespace covinz
