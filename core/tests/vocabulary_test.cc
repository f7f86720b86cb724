// Vocabulary training, lookup and bytes on generated clusters.
#include "covinz/vocabulary.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <stdexcept>
#include <string>

#include <gtest/gtest.h>

#include "covinz/vocabulary_training.h"
#include "vocabulary_problem.h"

namespace covinz {
namespace {

std::vector<int64_t> EqualImages(size_t num_descriptors, size_t per_image) {
  std::vector<int64_t> offsets;
  for (size_t i = 0; i <= num_descriptors; i += per_image) {
    offsets.push_back(static_cast<int64_t>(i));
  }
  return offsets;
}

Vocabulary Train(const std::vector<BinaryDescriptor>& descriptors,
                 int branching,
                 int depth,
                 uint64_t seed = 0) {
  return TrainVocabulary(descriptors, {0, static_cast<int64_t>(descriptors.size())},
                         {branching, depth, 25, seed});
}

TEST(BinaryDescriptor, HammingDistanceCountsBits) {
  std::mt19937_64 engine(1);
  const BinaryDescriptor a = RandomDescriptor(engine);
  EXPECT_EQ(HammingDistance(a, a), 0);
  EXPECT_EQ(HammingDistance(a, {~a[0], ~a[1], ~a[2], ~a[3]}), 256);
  for (size_t bits = 0; bits <= 256; ++bits) {
    EXPECT_EQ(HammingDistance(a, Flipped(a, 17, bits)), static_cast<int>(bits));
  }
}

TEST(BinaryDescriptor, NearestIsTheFirstOfEquals) {
  const BinaryDescriptor zero{};
  const std::vector<BinaryDescriptor> candidates = {Flipped(zero, 0, 9), Flipped(zero, 90, 4),
                                                    Flipped(zero, 200, 4)};
  EXPECT_EQ(NearestDescriptor(zero, candidates.data(), candidates.size()), 1u);
  EXPECT_EQ(NearestDescriptor(candidates[2], candidates.data(), candidates.size()), 2u);
}

TEST(Vocabulary, FindsTheClusters) {
  const size_t per_cluster = 50;
  const std::vector<BinaryDescriptor> descriptors = ClusteredDescriptors(8, per_cluster, 4, 2);
  const Vocabulary vocabulary = Train(descriptors, 8, 1);
  ASSERT_EQ(vocabulary.num_words(), 8u);
  const std::vector<uint32_t> words = vocabulary.Words(descriptors);
  std::set<uint32_t> distinct;
  for (size_t c = 0; c < 8; ++c) {
    const auto begin = words.begin() + static_cast<std::ptrdiff_t>(c * per_cluster);
    EXPECT_TRUE(std::all_of(begin, begin + per_cluster, [&](uint32_t w) { return w == *begin; }));
    distinct.insert(*begin);
  }
  EXPECT_EQ(distinct.size(), 8u);
}

TEST(Vocabulary, CentroidIsTheBitwiseMajority) {
  // Two groups far apart; in each, three descriptors vote on every bit.
  const BinaryDescriptor a{};
  const BinaryDescriptor b = {~0ull, ~0ull, ~0ull, ~0ull};
  const std::vector<BinaryDescriptor> descriptors = {Flipped(a, 0, 10),   Flipped(a, 5, 10),
                                                     Flipped(a, 100, 10), Flipped(b, 0, 10),
                                                     Flipped(b, 5, 10),   Flipped(b, 100, 10)};
  const std::vector<uint8_t> bytes = Train(descriptors, 2, 1).ToBytes();
  const std::vector<BinaryDescriptor> centroids =
      DescriptorsFromBytes<BinaryDescriptor>(&bytes[20], 3);
  // Bits 5 to 9 are flipped in two of three.
  const std::set<BinaryDescriptor> expected = {Flipped(a, 5, 5), Flipped(b, 5, 5)};
  EXPECT_EQ((std::set<BinaryDescriptor>{centroids[1], centroids[2]}), expected);
}

TEST(Vocabulary, GreedyDescentAgreesWithFlatSearchOnOneLevel) {
  const std::vector<BinaryDescriptor> descriptors = ClusteredDescriptors(30, 20, 100, 3);
  const Vocabulary vocabulary = Train(descriptors, 16, 1);
  const std::vector<uint8_t> bytes = vocabulary.ToBytes();
  const std::vector<BinaryDescriptor> centroids =
      DescriptorsFromBytes<BinaryDescriptor>(&bytes[20], vocabulary.num_words() + 1);
  std::mt19937_64 engine(4);
  for (int i = 0; i < 200; ++i) {
    const BinaryDescriptor query = RandomDescriptor(engine);
    int least = 257;
    uint32_t expected = 0;
    for (uint32_t w = 0; w < vocabulary.num_words(); ++w) {
      const int distance = HammingDistance(query, centroids[w + 1]);
      if (distance < least) {
        least = distance;
        expected = w;
      }
    }
    EXPECT_EQ(vocabulary.Words({query})[0], expected);
  }
}

TEST(Vocabulary, TreeOfTwoLevelsHasAllWords) {
  const std::vector<BinaryDescriptor> descriptors = ClusteredDescriptors(100, 10, 8, 5);
  const Vocabulary vocabulary = Train(descriptors, 5, 3);
  EXPECT_EQ(vocabulary.num_words(), 125u);
  const std::vector<uint32_t> words = vocabulary.Words(descriptors);
  // Every word was made of training descriptors, and each goes back to its own.
  EXPECT_EQ(std::set<uint32_t>(words.begin(), words.end()).size(), 125u);
}

TEST(Vocabulary, FewDistinctDescriptorsGiveFewWords) {
  const BinaryDescriptor zero{};
  const std::vector<BinaryDescriptor> equal(20, zero);
  EXPECT_EQ(Train(equal, 10, 4).num_words(), 1u);
  EXPECT_EQ(Train(equal, 10, 4).Words({Flipped(zero, 3, 100)}), std::vector<uint32_t>{0});
  EXPECT_EQ(Train({zero, Flipped(zero, 0, 1), zero, Flipped(zero, 9, 2)}, 10, 4).num_words(), 3u);
}

TEST(Vocabulary, IdfCountsImages) {
  // Four images; cluster A in all four, B in one (three times), C in two.
  std::mt19937_64 engine(6);
  const BinaryDescriptor A = RandomDescriptor(engine);
  const BinaryDescriptor B = RandomDescriptor(engine);
  const BinaryDescriptor C = RandomDescriptor(engine);
  const Vocabulary vocabulary =
      TrainVocabulary({A, B, B, B, A, C, A, A, C}, {0, 4, 6, 7, 9}, {3, 1, 25, 0});
  const std::vector<uint32_t> words = vocabulary.Words({A, B, C});
  EXPECT_FLOAT_EQ(vocabulary.idf()[words[0]], 0.0f);
  EXPECT_FLOAT_EQ(vocabulary.idf()[words[1]], std::log(4.0f));
  EXPECT_FLOAT_EQ(vocabulary.idf()[words[2]], std::log(2.0f));
}

TEST(Vocabulary, SameSeedSameBits) {
  const std::vector<BinaryDescriptor> descriptors = ClusteredDescriptors(60, 10, 60, 7);
  EXPECT_EQ(Train(descriptors, 4, 3, 1).ToBytes(), Train(descriptors, 4, 3, 1).ToBytes());
  EXPECT_NE(Train(descriptors, 4, 3, 1).ToBytes(), Train(descriptors, 4, 3, 2).ToBytes());
}

TEST(Vocabulary, TrainingRejectsMalformedInput) {
  const std::vector<BinaryDescriptor> two(2);
  const VocabularyTrainingOptions good;
  EXPECT_THROW(TrainVocabulary(std::vector<BinaryDescriptor>{}, {0, 0}, good),
               std::invalid_argument);
  EXPECT_THROW(TrainVocabulary(two, {}, good), std::invalid_argument);
  EXPECT_THROW(TrainVocabulary(two, {0}, good), std::invalid_argument);
  EXPECT_THROW(TrainVocabulary(two, {0, 1}, good), std::invalid_argument);
  EXPECT_THROW(TrainVocabulary(two, {1, 2}, good), std::invalid_argument);
  EXPECT_THROW(TrainVocabulary(two, {0, 3}, good), std::invalid_argument);
  EXPECT_THROW(TrainVocabulary(two, {0, 2, 1, 2}, good), std::invalid_argument);
  EXPECT_THROW(TrainVocabulary(two, {0, -1, 2}, good), std::invalid_argument);
  for (const VocabularyTrainingOptions& bad :
       std::vector<VocabularyTrainingOptions>{{1, 4, 25, 0},
                                              {256, 1, 25, 0},
                                              {10, 0, 25, 0},
                                              {10, 17, 25, 0},
                                              {10, 8, 25, 0},
                                              {10, 4, -1, 0}}) {
    EXPECT_THROW(TrainVocabulary(two, {0, 2}, bad), std::invalid_argument);
  }
}

class VocabularyBytes : public testing::Test {
 protected:
  static std::string RejectionOf(const std::vector<uint8_t>& bytes) {
    try {
      Vocabulary::FromBytes(bytes.data(), bytes.size());
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  }

  // 4 words under the root: 5 nodes.
  const Vocabulary vocabulary_ = Train(ClusteredDescriptors(4, 10, 20, 9), 4, 1);
  const std::vector<uint8_t> bytes_ = vocabulary_.ToBytes();
  const size_t children_ = 20 + 5 * 32;  // where the numbers of children start
  const size_t idf_ = children_ + 5;
};

TEST_F(VocabularyBytes, RoundTrip) {
  const std::vector<BinaryDescriptor> descriptors = ClusteredDescriptors(60, 10, 60, 10);
  const Vocabulary vocabulary = TrainVocabulary(descriptors, EqualImages(600, 60), {4, 3, 25, 0});
  const std::vector<uint8_t> bytes = vocabulary.ToBytes();
  const Vocabulary copy = Vocabulary::FromBytes(bytes.data(), bytes.size());
  EXPECT_EQ(copy.ToBytes(), bytes);
  EXPECT_EQ(copy.idf(), vocabulary.idf());
  EXPECT_EQ(copy.Words(descriptors), vocabulary.Words(descriptors));
}

TEST_F(VocabularyBytes, EveryTruncationIsRejected) {
  for (size_t length = 0; length < bytes_.size(); ++length) {
    EXPECT_NE(RejectionOf({bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(length)}),
              "");
  }
}

TEST_F(VocabularyBytes, TrailingBytesAreRejected) {
  std::vector<uint8_t> longer = bytes_;
  longer.push_back(0);
  EXPECT_NE(RejectionOf(longer).find("length"), std::string::npos);
}

TEST_F(VocabularyBytes, RandomBytesAreRejected) {
  std::mt19937_64 engine(11);
  for (int i = 0; i < 200; ++i) {
    std::vector<uint8_t> noise(engine() % 500);
    for (uint8_t& byte : noise) byte = static_cast<uint8_t>(engine());
    EXPECT_NE(RejectionOf(noise), "");
  }
}

TEST_F(VocabularyBytes, MalformedTreesAreRejected) {
  ASSERT_EQ(RejectionOf(bytes_), "");
  const auto expect = [&](const std::string& message, const auto& spoil) {
    std::vector<uint8_t> bytes = bytes_;
    spoil(bytes);
    EXPECT_NE(RejectionOf(bytes).find(message), std::string::npos) << RejectionOf(bytes);
  };
  expect("a child too many", [&](auto& bytes) { bytes[children_] = 5; });
  expect("no parent", [&](auto& bytes) { bytes[children_] = 3; });
  expect("single child", [&](auto& bytes) { bytes[children_] = 1; });
  expect("no parent", [&](auto& bytes) { bytes[children_] = 0; });
  expect("number of words", [&](auto& bytes) { bytes[children_] = 2, bytes[children_ + 2] = 2; });
  expect("unknown version", [&](auto& bytes) { bytes[8] = 3; });
  expect("not a vocabulary", [&](auto& bytes) { bytes[0] = 'C'; });
  // -1, then NaN, as float32.
  expect("idf", [&](auto& bytes) { bytes[idf_ + 2] = 0x80, bytes[idf_ + 3] = 0xbf; });
  expect("idf", [&](auto& bytes) { bytes[idf_ + 2] = 0xc0, bytes[idf_ + 3] = 0x7f; });
}

TEST_F(VocabularyBytes, HugeCountsAreRejectedWithoutAllocation) {
  std::vector<uint8_t> bytes = bytes_;
  std::fill(bytes.begin() + 12, bytes.begin() + 20, uint8_t{0xff});
  EXPECT_NE(RejectionOf(bytes).find("length"), std::string::npos);
}

TEST(Vocabulary, EndlessTreesAreRejected) {
  // A chain of pairs, deeper than the limit.
  std::vector<uint8_t> num_children;
  for (uint32_t level = 0; level <= Vocabulary::kMaxDepth; ++level) {
    num_children.insert(num_children.end(), {2, 0});
  }
  num_children.push_back(0);
  const size_t num_leaves = Vocabulary::kMaxDepth + 2;
  // Level by level: root, then pairs of (inner, leaf).
  EXPECT_THROW(Vocabulary(std::vector<BinaryDescriptor>(num_children.size()), num_children,
                          std::vector<float>(num_leaves, 1.0f)),
               std::invalid_argument);
}

}  // namespace
}  // namespace covinz
