// Hierarchical k-majority and k-means.
#include "covinz/vocabulary_training.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <random>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>

namespace covinz {
namespace {

void Require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(std::string("Vocabulary training: ") + message);
}

using Indices = std::vector<uint32_t>;

// Uniform in [0, n), unbiased; the standard fixes the engine but not its distributions.
uint64_t DrawBelow(uint64_t n, std::mt19937_64& engine) {
  const uint64_t limit = n * (UINT64_MAX / n);
  uint64_t value = engine();
  while (value >= limit) value = engine();
  return value % n;
}

uint64_t SeedingWeight(const BinaryDescriptor& a, const BinaryDescriptor& b) {
  const auto distance = static_cast<uint64_t>(HammingDistance(a, b));
  return distance * distance;
}

uint64_t SeedingWeight(const ByteDescriptor& a, const ByteDescriptor& b) {
  return static_cast<uint64_t>(SquaredDistance(a, b));
}

// The bitwise majority; a tie keeps the bit of the previous centroid.
BinaryDescriptor Centre(const std::vector<BinaryDescriptor>& descriptors,
                        const Indices& members,
                        const BinaryDescriptor& previous) {
  std::array<uint32_t, 256> ones{};
  for (const uint32_t i : members) {
    for (size_t bit = 0; bit < ones.size(); ++bit) {
      ones[bit] += static_cast<uint32_t>(descriptors[i][bit / 64] >> (bit % 64)) & 1u;
    }
  }
  BinaryDescriptor centre = previous;
  for (size_t bit = 0; bit < ones.size(); ++bit) {
    const uint64_t mask = uint64_t{1} << (bit % 64);
    if (2 * size_t{ones[bit]} > members.size()) centre[bit / 64] |= mask;
    if (2 * size_t{ones[bit]} < members.size()) centre[bit / 64] &= ~mask;
  }
  return centre;
}

// The mean, rounded; that of no members is the previous centroid.
ByteDescriptor Centre(const std::vector<ByteDescriptor>& descriptors,
                      const Indices& members,
                      const ByteDescriptor& previous) {
  if (members.empty()) return previous;
  std::array<uint64_t, std::tuple_size_v<ByteDescriptor>> sums{};
  for (const uint32_t i : members) {
    for (size_t k = 0; k < sums.size(); ++k) sums[k] += descriptors[i][k];
  }
  ByteDescriptor centre;
  for (size_t k = 0; k < sums.size(); ++k) {
    centre[k] = static_cast<uint8_t>((2 * sums[k] + members.size()) / (2 * members.size()));
  }
  return centre;
}

template <typename Descriptor>
class Clustering {
 public:
  Clustering(const std::vector<Descriptor>& descriptors, const VocabularyTrainingOptions& options)
      : descriptors_(descriptors), options_(options), engine_(options.seed) {}

  struct Cluster {
    Descriptor centroid;
    Indices members;
  };

  // Clusters of the members, none empty; a single one if all members are equal.
  std::vector<Cluster> Split(const Indices& members) {
    std::vector<Descriptor> centroids = Seed(members);
    std::vector<Indices> assigned = Assign(members, centroids);
    for (int i = 0; i < options_.max_num_iterations; ++i) {
      std::vector<Descriptor> moved = centroids;
      for (size_t k = 0; k < moved.size(); ++k) {
        moved[k] = Centre(descriptors_, assigned[k], centroids[k]);
      }
      if (moved == centroids) break;
      centroids = std::move(moved);
      assigned = Assign(members, centroids);
    }
    std::vector<Cluster> clusters;
    for (size_t k = 0; k < centroids.size(); ++k) {
      if (!assigned[k].empty()) clusters.push_back({centroids[k], std::move(assigned[k])});
    }
    return clusters;
  }

 private:
  // k-means++: each further centroid is a member drawn by its squared distance to the nearest.
  std::vector<Descriptor> Seed(const Indices& members) {
    std::vector<Descriptor> centroids = {descriptors_[members[DrawBelow(members.size(), engine_)]]};
    std::vector<uint64_t> weights(members.size(), UINT64_MAX);
    while (centroids.size() < static_cast<size_t>(options_.branching)) {
      const uint64_t total = UpdateWeights(members, centroids.back(), weights);
      if (total == 0) break;  // fewer distinct members than centroids
      uint64_t draw = DrawBelow(total, engine_);
      size_t i = 0;
      while (draw >= weights[i]) draw -= weights[i++];
      centroids.push_back(descriptors_[members[i]]);
    }
    return centroids;
  }

  uint64_t UpdateWeights(const Indices& members,
                         const Descriptor& centroid,
                         std::vector<uint64_t>& weights) const {
    uint64_t total = 0;
    for (size_t i = 0; i < members.size(); ++i) {
      weights[i] = std::min(weights[i], SeedingWeight(descriptors_[members[i]], centroid));
      total += weights[i];
    }
    return total;
  }

  std::vector<Indices> Assign(const Indices& members,
                              const std::vector<Descriptor>& centroids) const {
    std::vector<Indices> assigned(centroids.size());
    for (const uint32_t i : members) {
      assigned[NearestDescriptor(descriptors_[i], centroids.data(), centroids.size())].push_back(i);
    }
    return assigned;
  }

  const std::vector<Descriptor>& descriptors_;
  const VocabularyTrainingOptions options_;
  std::mt19937_64 engine_;
};

template <typename Descriptor>
struct Tree {
  std::vector<Descriptor> centroids;
  std::vector<uint8_t> num_children;
};

// Level by level, so that the children of a node are contiguous.
template <typename Descriptor>
Tree<Descriptor> GrowTree(const std::vector<Descriptor>& descriptors,
                          const VocabularyTrainingOptions& options) {
  Clustering<Descriptor> clustering(descriptors, options);
  Indices all(descriptors.size());
  std::iota(all.begin(), all.end(), 0u);
  Tree<Descriptor> tree{{Descriptor{}}, {}};
  std::vector<Indices> level = {std::move(all)};
  for (int depth = 0; depth < options.depth; ++depth) {
    std::vector<Indices> next_level;
    for (const Indices& members : level) {
      std::vector<typename Clustering<Descriptor>::Cluster> clusters = clustering.Split(members);
      if (clusters.size() == 1) clusters.clear();
      tree.num_children.push_back(static_cast<uint8_t>(clusters.size()));
      for (auto& cluster : clusters) {
        tree.centroids.push_back(cluster.centroid);
        next_level.push_back(std::move(cluster.members));
      }
    }
    level = std::move(next_level);
  }
  tree.num_children.resize(tree.centroids.size(), 0);
  return tree;
}

std::vector<float> InverseDocumentFrequencies(const std::vector<uint32_t>& words,
                                              const std::vector<int64_t>& image_offsets,
                                              size_t num_words) {
  std::vector<size_t> num_images(num_words, 0);
  const size_t num_all_images = image_offsets.size() - 1;
  for (size_t image = 0; image < num_all_images; ++image) {
    std::vector<uint32_t> held(words.begin() + image_offsets[image],
                               words.begin() + image_offsets[image + 1]);
    std::sort(held.begin(), held.end());
    held.erase(std::unique(held.begin(), held.end()), held.end());
    for (const uint32_t word : held) ++num_images[word];
  }
  std::vector<float> idf(num_words);
  for (size_t word = 0; word < num_words; ++word) {
    const double ratio =
        static_cast<double>(num_all_images) / static_cast<double>(num_images[word]);
    idf[word] = static_cast<float>(std::log(ratio));
  }
  return idf;
}

void CheckOffsets(const std::vector<int64_t>& image_offsets, size_t num_descriptors) {
  Require(num_descriptors > 0, "no descriptors");
  Require(num_descriptors <= UINT32_MAX, "too many descriptors");
  Require(image_offsets.size() >= 2, "no image");
  Require(image_offsets.front() == 0 &&
              image_offsets.back() == static_cast<int64_t>(num_descriptors) &&
              std::is_sorted(image_offsets.begin(), image_offsets.end()),
          "image offsets do not ascend from 0 to the number of descriptors");
}

template <typename Descriptor>
BasicVocabulary<Descriptor> Train(const std::vector<Descriptor>& descriptors,
                                  const std::vector<int64_t>& image_offsets,
                                  const VocabularyTrainingOptions& options) {
  options.Check();
  CheckOffsets(image_offsets, descriptors.size());
  const Tree<Descriptor> tree = GrowTree(descriptors, options);
  const auto num_words = static_cast<size_t>(
      std::count(tree.num_children.begin(), tree.num_children.end(), uint8_t{0}));
  const BasicVocabulary<Descriptor> unweighted(tree.centroids, tree.num_children,
                                               std::vector<float>(num_words, 0.0f));
  return BasicVocabulary<Descriptor>(
      tree.centroids, tree.num_children,
      InverseDocumentFrequencies(unweighted.Words(descriptors), image_offsets, num_words));
}

}  // namespace

void VocabularyTrainingOptions::Check() const {
  Require(branching >= 2 && branching <= static_cast<int>(Vocabulary::kMaxBranching),
          "branching must be 2 to 255");
  Require(depth >= 1 && depth <= static_cast<int>(Vocabulary::kMaxDepth), "depth must be 1 to 16");
  Require(std::pow(branching, depth) * 2.0 <= Vocabulary::kMaxNodes, "too many words");
  Require(max_num_iterations >= 0, "max_num_iterations must not be negative");
}

Vocabulary TrainVocabulary(const std::vector<BinaryDescriptor>& descriptors,
                           const std::vector<int64_t>& image_offsets,
                           const VocabularyTrainingOptions& options) {
  return Train(descriptors, image_offsets, options);
}

ByteVocabulary TrainVocabulary(const std::vector<ByteDescriptor>& descriptors,
                               const std::vector<int64_t>& image_offsets,
                               const VocabularyTrainingOptions& options) {
  return Train(descriptors, image_offsets, options);
}

}  // namespace covinz
