// Verified votes.
#include "covinz/inverted_index.h"

#include <cmath>
#include <stdexcept>

namespace covinz {
namespace {

void CheckLengths(size_t num_words, size_t num_descriptors) {
  if (num_words != num_descriptors) {
    throw std::invalid_argument("Inverted index: the numbers of words and descriptors differ");
  }
}

// Writes the keyframes that hold a descriptor near the query, each once, and returns how many;
// `hits` has room for all. `keyframes` ascends, so repeats are neighbours.
COVINZ_POPCNT_CLONES
size_t FindHits(const BinaryDescriptor& query,
                const std::vector<BinaryDescriptor>& descriptors,
                const std::vector<uint32_t>& keyframes,
                int max_hamming,
                uint32_t* hits) {
  size_t num_hits = 0;
  for (size_t i = 0; i < descriptors.size(); ++i) {
    if (HammingDistance(query, descriptors[i]) > max_hamming) continue;
    if (num_hits == 0 || hits[num_hits - 1] != keyframes[i]) hits[num_hits++] = keyframes[i];
  }
  return num_hits;
}

}  // namespace

InvertedIndex::InvertedIndex(int max_hamming) : max_hamming_(max_hamming) {
  if (max_hamming < 0 || max_hamming > 256) {
    throw std::invalid_argument("Inverted index: max_hamming must be 0 to 256");
  }
}

uint32_t InvertedIndex::Add(const std::vector<uint32_t>& words,
                            const std::vector<BinaryDescriptor>& descriptors) {
  CheckLengths(words.size(), descriptors.size());
  for (size_t i = 0; i < words.size(); ++i) {
    Postings& postings = postings_[words[i]];
    postings.keyframes.push_back(size_);
    postings.descriptors.push_back(descriptors[i]);
  }
  return size_++;
}

std::vector<float> InvertedIndex::Votes(const std::vector<uint32_t>& words,
                                        const std::vector<BinaryDescriptor>& descriptors) const {
  CheckLengths(words.size(), descriptors.size());
  std::vector<double> votes(size_, 0.0);
  std::vector<uint32_t> hits;
  for (size_t i = 0; i < words.size(); ++i) {
    const auto found = postings_.find(words[i]);
    if (found == postings_.end()) continue;
    const Postings& postings = found->second;
    if (hits.size() < postings.keyframes.size()) hits.resize(postings.keyframes.size());
    const size_t num_hits = FindHits(descriptors[i], postings.descriptors, postings.keyframes,
                                     max_hamming_, hits.data());
    if (num_hits == 0) continue;
    const double weight = std::log(static_cast<double>(size_) / static_cast<double>(num_hits));
    for (size_t k = 0; k < num_hits; ++k) votes[hits[k]] += weight;
  }
  return std::vector<float>(votes.begin(), votes.end());
}

}  // namespace covinz
