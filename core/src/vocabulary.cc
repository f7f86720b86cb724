// The tree of a vocabulary and the descent to a word.
#include "covinz/vocabulary.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

namespace covinz {
namespace {

void Require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(std::string("Vocabulary: ") + message);
}

// Links the levels; nodes come level by level, so each one's children follow those of the last.
std::vector<VocabularyNode> LinkNodes(const std::vector<uint8_t>& num_children,
                                      uint32_t max_depth) {
  std::vector<VocabularyNode> nodes(num_children.size());
  std::vector<uint32_t> level(num_children.size(), 0);
  uint32_t next_child = 1;
  uint32_t next_word = 0;
  for (size_t i = 0; i < nodes.size(); ++i) {
    Require(i < next_child, "a node has no parent");
    Require(num_children[i] != 1, "a node has a single child");
    nodes[i].num_children = num_children[i];
    if (num_children[i] == 0) {
      nodes[i].word = next_word++;
      continue;
    }
    nodes[i].first_child = next_child;
    Require(num_children[i] <= nodes.size() - next_child, "a node has a child too many");
    Require(level[i] < max_depth, "the tree is too deep");
    for (uint32_t k = 0; k < num_children[i]; ++k) level[next_child++] = level[i] + 1;
  }
  return nodes;
}

}  // namespace

template <typename Descriptor>
BasicVocabulary<Descriptor>::BasicVocabulary(std::vector<Descriptor> centroids,
                                             const std::vector<uint8_t>& num_children,
                                             std::vector<float> idf)
    : centroids_(std::move(centroids)), idf_(std::move(idf)) {
  Require(!centroids_.empty() && centroids_.size() <= kMaxNodes, "number of nodes out of range");
  Require(centroids_.size() == num_children.size(), "number of nodes differs");
  nodes_ = LinkNodes(num_children, kMaxDepth);
  const auto num_leaves = std::count(num_children.begin(), num_children.end(), uint8_t{0});
  Require(static_cast<size_t>(num_leaves) == idf_.size(), "number of words differs");
  for (const float weight : idf_) {
    Require(std::isfinite(weight) && weight >= 0.0f, "an idf weight is negative or not finite");
  }
}

template <typename Descriptor>
std::vector<uint32_t> BasicVocabulary<Descriptor>::Words(
    const std::vector<Descriptor>& descriptors) const {
  std::vector<uint32_t> words;
  words.reserve(descriptors.size());
  for (const Descriptor& descriptor : descriptors) {
    const VocabularyNode* node = &nodes_.front();
    while (node->num_children > 0) {
      const Descriptor* children = centroids_.data() + node->first_child;
      const size_t nearest = NearestDescriptor(descriptor, children, node->num_children);
      node = &nodes_[node->first_child + nearest];
    }
    words.push_back(node->word);
  }
  return words;
}

template <typename Descriptor>
std::vector<Descriptor> BasicVocabulary<Descriptor>::WordCentroids() const {
  std::vector<Descriptor> centroids;
  for (size_t i = 0; i < nodes_.size(); ++i) {
    if (nodes_[i].num_children == 0) centroids.push_back(centroids_[i]);
  }
  return centroids;
}

template class BasicVocabulary<BinaryDescriptor>;
template class BasicVocabulary<ByteDescriptor>;

}  // namespace covinz
