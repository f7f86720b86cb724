// A visual vocabulary: a tree of centroids whose leaves are words.
#pragma once

#include <cstdint>
#include <vector>

#include "covinz/binary_descriptor.h"
#include "covinz/byte_descriptor.h"

namespace covinz {

// One node of the tree. Nodes are stored level by level, so children are contiguous.
struct VocabularyNode {
  uint32_t first_child = 0;
  uint32_t num_children = 0;  // 0: a leaf
  uint32_t word = 0;          // of a leaf: its rank among the leaves
};

// Words of one kind of descriptor.
//
// Source: Nister and Stewenius, "Scalable recognition with a vocabulary tree", CVPR 2006, over
// binary centroids as in Galvez-Lopez and Tardos, "Bags of binary words for fast place
// recognition in image sequences", T-RO 2012.
template <typename Descriptor>
class BasicVocabulary {
 public:
  static constexpr uint32_t kMaxBranching = 255;
  static constexpr uint32_t kMaxDepth = 16;
  static constexpr uint32_t kMaxNodes = 1u << 24;

  // From the parts that TrainVocabulary makes: a centroid (the root's is unused) and the number
  // of children of each node, level by level, and the idf weight of each leaf in that order.
  // Throws std::invalid_argument where they do not describe one tree within the limits.
  BasicVocabulary(std::vector<Descriptor> centroids,
                  const std::vector<uint8_t>& num_children,
                  std::vector<float> idf);

  // The word of each descriptor: at every level, on to the nearest child (the first of equals).
  std::vector<uint32_t> Words(const std::vector<Descriptor>& descriptors) const;

  uint32_t num_words() const { return static_cast<uint32_t>(idf_.size()); }

  // log(number of training images / number that hold the word) of each word.
  const std::vector<float>& idf() const { return idf_; }

  // The centroid of each word.
  std::vector<Descriptor> WordCentroids() const;

  // Little-endian: "covinz-v", kind of descriptor (1 binary, 2 bytes), number of nodes and of words
  // (uint32), centroids (32 or 128 bytes each), numbers of children (uint8), idf (float32). The
  // Python bindings add the checksum that is also the vocabulary's identity.
  std::vector<uint8_t> ToBytes() const;

  // Inverse of ToBytes. Throws std::invalid_argument on anything that ToBytes cannot have made.
  static BasicVocabulary FromBytes(const uint8_t* bytes, size_t num_bytes);

 private:
  std::vector<Descriptor> centroids_;
  std::vector<VocabularyNode> nodes_;
  std::vector<float> idf_;
};

// Of 256-bit descriptors.
using Vocabulary = BasicVocabulary<BinaryDescriptor>;
// Of 128-byte descriptors.
using ByteVocabulary = BasicVocabulary<ByteDescriptor>;

extern template class BasicVocabulary<BinaryDescriptor>;
extern template class BasicVocabulary<ByteDescriptor>;

}  // namespace covinz
