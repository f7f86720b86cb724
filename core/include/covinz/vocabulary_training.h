// Training of a vocabulary by hierarchical k-majority or k-means.
#pragma once

#include <cstdint>
#include <vector>

#include "covinz/vocabulary.h"

namespace covinz {

// Options of TrainVocabulary.
struct VocabularyTrainingOptions {
  // At most branching^depth words. [research: 10^4 words serve as an index for thousands of
  // keyframes, in a file of 0.4 MB]
  int branching = 10;
  int depth = 4;
  // Rounds per node; they mostly end earlier, when no centroid changes.
  int max_num_iterations = 25;
  // Same seed and input, same bits.
  uint64_t seed = 0;

  void Check() const;  // throws std::invalid_argument
};

// Splits the descriptors into `branching` clusters, these again, `depth` times. A centroid is
// the bitwise majority of its cluster (a tie keeps the bit) or, of bytes, its rounded mean, seeded
// as in k-means++ with squared distances. A cluster of equal descriptors stays a leaf, so there can
// be fewer words.
//
// Image i holds the descriptors image_offsets[i] to image_offsets[i + 1], for the idf weights.
//
// Source: Grana et al., "A fast approach for integrating ORB descriptors in the bag of words
// model", 2013 (k-majority); Arthur and Vassilvitskii, "k-means++", SODA 2007 (seeding).
//
// Throws std::invalid_argument where there is no descriptor, or the offsets do not ascend from 0
// to the number of descriptors.
Vocabulary TrainVocabulary(const std::vector<BinaryDescriptor>& descriptors,
                           const std::vector<int64_t>& image_offsets,
                           const VocabularyTrainingOptions& options);
ByteVocabulary TrainVocabulary(const std::vector<ByteDescriptor>& descriptors,
                               const std::vector<int64_t>& image_offsets,
                               const VocabularyTrainingOptions& options);

}  // namespace covinz
