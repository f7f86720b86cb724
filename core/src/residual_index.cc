// Codes of descriptors within their words, and votes over them.
#include "covinz/residual_index.h"

#include <stdexcept>

namespace covinz {

ResidualIndex::ResidualIndex(const ByteVocabulary& vocabulary, int max_hamming)
    : centroids_(vocabulary.WordCentroids()), index_(max_hamming) {}

uint32_t ResidualIndex::Add(const std::vector<uint32_t>& words,
                            const std::vector<ByteDescriptor>& descriptors) {
  return index_.Add(words, Codes(words, descriptors));
}

std::vector<float> ResidualIndex::Votes(const std::vector<uint32_t>& words,
                                        const std::vector<ByteDescriptor>& descriptors) const {
  return index_.Votes(words, Codes(words, descriptors));
}

std::vector<ResidualIndex::Index::Code> ResidualIndex::Codes(
    const std::vector<uint32_t>& words, const std::vector<ByteDescriptor>& descriptors) const {
  if (words.size() != descriptors.size()) {
    throw std::invalid_argument("Residual index: the numbers of words and descriptors differ");
  }
  std::vector<Index::Code> codes(words.size(), Index::Code{});
  for (size_t i = 0; i < words.size(); ++i) {
    if (words[i] >= centroids_.size()) {
      throw std::invalid_argument("Residual index: a word is not in the vocabulary");
    }
    const ByteDescriptor& centroid = centroids_[words[i]];
    for (size_t k = 0; k < centroid.size(); ++k) {
      codes[i][k / 64] |= uint64_t{descriptors[i][k] > centroid[k]} << (k % 64);
    }
  }
  return codes;
}

}  // namespace covinz
