// Vocabularies and codes of 128-byte descriptors: worked examples, known clusters, kinds.
#include <algorithm>
#include <cmath>
#include <random>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "covinz/residual_index.h"
#include "covinz/tf_idf_index.h"
#include "covinz/vocabulary_training.h"
#include "vocabulary_problem.h"

namespace covinz {
namespace {

ByteDescriptor Constant(uint8_t value) {
  ByteDescriptor descriptor;
  descriptor.fill(value);
  return descriptor;
}

// num_clusters * per_cluster descriptors around random centres, each component up to `noise` off.
std::vector<ByteDescriptor> Clusters(size_t num_clusters, size_t per_cluster, uint64_t seed) {
  constexpr int kNoise = 5;
  std::mt19937_64 engine(seed);
  std::vector<ByteDescriptor> descriptors;
  for (size_t c = 0; c < num_clusters; ++c) {
    ByteDescriptor centre;
    for (uint8_t& value : centre) value = static_cast<uint8_t>(kNoise + engine() % 240);
    for (size_t i = 0; i < per_cluster; ++i) {
      ByteDescriptor descriptor = centre;
      for (uint8_t& value : descriptor) {
        value = static_cast<uint8_t>(value + engine() % (2 * kNoise + 1) - kNoise);
      }
      descriptors.push_back(descriptor);
    }
  }
  return descriptors;
}

ByteVocabulary Train(const std::vector<ByteDescriptor>& descriptors, int branching, int depth) {
  return TrainVocabulary(descriptors, {0, static_cast<int64_t>(descriptors.size())},
                         {branching, depth, 25, 3});
}

TEST(ByteDescriptor, SquaredDistance) {
  EXPECT_EQ(SquaredDistance(Constant(7), Constant(7)), 0);
  EXPECT_EQ(SquaredDistance(Constant(0), Constant(255)), 128 * 255 * 255);
  EXPECT_EQ(SquaredDistance(Constant(9), Constant(6)), 128 * 9);
}

TEST(ByteDescriptor, NearestIsTheFirstOfEquals) {
  const std::vector<ByteDescriptor> candidates = {Constant(10), Constant(4), Constant(6)};
  EXPECT_EQ(NearestDescriptor(Constant(5), candidates.data(), 3), 1u);
  EXPECT_EQ(NearestDescriptor(Constant(9), candidates.data(), 3), 0u);
}

TEST(ByteVocabulary, FindsTheClusters) {
  const size_t per_cluster = 30;
  const std::vector<ByteDescriptor> descriptors = Clusters(8, per_cluster, 1);
  const ByteVocabulary vocabulary = Train(descriptors, 8, 1);
  ASSERT_EQ(vocabulary.num_words(), 8u);
  const std::vector<uint32_t> words = vocabulary.Words(descriptors);
  std::set<uint32_t> distinct;
  for (size_t i = 0; i < words.size(); ++i) {
    EXPECT_EQ(words[i], words[i / per_cluster * per_cluster]);
    distinct.insert(words[i]);
  }
  EXPECT_EQ(distinct.size(), 8u);
}

TEST(ByteVocabulary, CentroidIsTheRoundedMean) {
  const ByteVocabulary vocabulary =
      Train({Constant(0), Constant(1), Constant(200), Constant(203), Constant(203)}, 2, 1);
  const std::vector<ByteDescriptor> centroids = vocabulary.WordCentroids();
  const std::set<ByteDescriptor> expected = {Constant(1), Constant(202)};
  EXPECT_EQ((std::set<ByteDescriptor>(centroids.begin(), centroids.end())), expected);
}

TEST(ByteVocabulary, WordCentroidsAreInTheOrderOfWords) {
  const std::vector<ByteDescriptor> descriptors = Clusters(40, 10, 2);
  const ByteVocabulary vocabulary = Train(descriptors, 3, 3);
  const std::vector<ByteDescriptor> centroids = vocabulary.WordCentroids();
  const std::vector<uint32_t> words = vocabulary.Words(descriptors);
  ASSERT_EQ(centroids.size(), vocabulary.num_words());
  for (uint32_t word = 0; word < vocabulary.num_words(); ++word) {
    std::array<int, 128> sums{};
    int count = 0;
    for (size_t i = 0; i < words.size(); ++i) {
      if (words[i] != word) continue;
      ++count;
      for (size_t k = 0; k < sums.size(); ++k) sums[k] += descriptors[i][k];
    }
    ASSERT_GT(count, 0);
    for (size_t k = 0; k < sums.size(); ++k) {
      EXPECT_NEAR(centroids[word][k], static_cast<double>(sums[k]) / count, 0.51);
    }
  }
}

TEST(ByteVocabulary, SameSeedSameBitsAndRoundTrip) {
  const std::vector<ByteDescriptor> descriptors = Clusters(40, 10, 4);
  const std::vector<uint8_t> bytes = Train(descriptors, 4, 3).ToBytes();
  EXPECT_EQ(bytes, Train(descriptors, 4, 3).ToBytes());
  const ByteVocabulary copy = ByteVocabulary::FromBytes(bytes.data(), bytes.size());
  EXPECT_EQ(copy.ToBytes(), bytes);
  EXPECT_EQ(copy.Words(descriptors), Train(descriptors, 4, 3).Words(descriptors));
}

TEST(ByteVocabulary, KindsAreNotMixedUp) {
  const auto rejection = [](auto read) {
    try {
      read();
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  const std::vector<uint8_t> bytes = Train(Clusters(4, 4, 5), 4, 1).ToBytes();
  const std::vector<BinaryDescriptor> binary = ClusteredDescriptors(4, 4, 9, 5);
  const std::vector<uint8_t> bits = TrainVocabulary(binary, {0, 16}, {4, 1, 25, 0}).ToBytes();
  EXPECT_NE(rejection([&] { Vocabulary::FromBytes(bytes.data(), bytes.size()); }).find("128-byte"),
            std::string::npos);
  EXPECT_NE(rejection([&] { ByteVocabulary::FromBytes(bits.data(), bits.size()); }).find("32-byte"),
            std::string::npos);
}

// One word, whose centroid is 100 in every component.
ByteVocabulary OneWord() { return {{Constant(0), Constant(100), Constant(0)}, {2, 0, 0}, {1, 1}}; }

// Above the centroid in the first `above` components, below in the others.
ByteDescriptor Above(size_t above) {
  ByteDescriptor descriptor = Constant(90);
  std::fill_n(descriptor.begin(), above, uint8_t{110});
  return descriptor;
}

TEST(ResidualIndex, CodesSayWhatIsAboveTheCentroid) {
  ResidualIndex index(OneWord(), 20);
  EXPECT_EQ(index.Add({0}, {Above(20)}), 0u);
  EXPECT_EQ(index.Add({0}, {Above(21)}), 1u);  // one bit too far
  EXPECT_EQ(index.Add({1}, {Above(0)}), 2u);   // another word
  ByteDescriptor equal = Above(0);
  std::fill_n(equal.begin(), 30, uint8_t{100});  // not above
  EXPECT_EQ(index.Add({0}, {equal}), 3u);
  EXPECT_EQ(index.size(), 4u);
  const std::vector<float> votes = index.Votes({0}, {Above(0)});
  const float weight = std::log(2.0f);
  EXPECT_EQ(votes, (std::vector<float>{weight, 0.0f, 0.0f, weight}));
}

TEST(ResidualIndex, AFeatureFindsItsNoisyCopy) {
  const std::vector<ByteDescriptor> descriptors = Clusters(50, 12, 6);
  const ByteVocabulary vocabulary = Train(descriptors, 5, 1);
  ResidualIndex index(vocabulary);
  for (size_t c = 0; c < 50; ++c) {
    index.Add(vocabulary.Words({descriptors[12 * c]}), {descriptors[12 * c]});
  }
  for (size_t c = 0; c < 50; ++c) {
    const ByteDescriptor& query = descriptors[12 * c + 1];
    const std::vector<float> votes = index.Votes(vocabulary.Words({query}), {query});
    EXPECT_EQ(std::max_element(votes.begin(), votes.end()) - votes.begin(),
              static_cast<std::ptrdiff_t>(c));
  }
}

TEST(ResidualIndex, RejectsMalformedInput) {
  EXPECT_THROW(ResidualIndex(OneWord(), -1), std::invalid_argument);
  EXPECT_THROW(ResidualIndex(OneWord(), 129), std::invalid_argument);
  ResidualIndex index(OneWord());
  EXPECT_THROW(index.Add({0, 1}, {Above(0)}), std::invalid_argument);
  EXPECT_THROW(index.Add({2}, {Above(0)}), std::invalid_argument);
  EXPECT_THROW(index.Votes({}, {Above(0)}), std::invalid_argument);
  EXPECT_EQ(index.size(), 0u);
  EXPECT_TRUE(index.Votes({}, {}).empty());
}

TEST(TfIdfIndex, TakesEitherKindOfVocabulary) {
  TfIdfIndex index(OneWord());
  index.Add({0, 1});
  EXPECT_FLOAT_EQ(index.Scores({0, 1})[0], 1.0f);
  EXPECT_THROW(index.Add({2}), std::invalid_argument);
}

}  // namespace
}  // namespace covinz
