// Verified votes: worked examples and a brute-force count.
#include "covinz/inverted_index.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <stdexcept>

#include <gtest/gtest.h>

#include "vocabulary_problem.h"

namespace covinz {
namespace {

struct Bag {
  std::vector<uint32_t> words;
  std::vector<BinaryDescriptor> descriptors;
};

// Descriptors near few centres under few words, so that votes and near misses abound.
Bag RandomBag(size_t size, std::mt19937_64& engine) {
  Bag bag;
  for (size_t i = 0; i < size; ++i) {
    bag.words.push_back(static_cast<uint32_t>(engine() % 5) * 1000003u);
    std::mt19937_64 centre(engine() % 7);
    bag.descriptors.push_back(Flipped(RandomDescriptor(centre), engine() % 256, engine() % 60));
  }
  return bag;
}

std::vector<float> BruteForceVotes(const std::vector<Bag>& keyframes,
                                   const Bag& query,
                                   int max_hamming) {
  std::vector<double> votes(keyframes.size(), 0.0);
  for (size_t i = 0; i < query.words.size(); ++i) {
    std::vector<size_t> hit;
    for (size_t k = 0; k < keyframes.size(); ++k) {
      for (size_t j = 0; j < keyframes[k].words.size(); ++j) {
        if (keyframes[k].words[j] == query.words[i] &&
            HammingDistance(keyframes[k].descriptors[j], query.descriptors[i]) <= max_hamming) {
          hit.push_back(k);
          break;
        }
      }
    }
    for (const size_t k : hit) {
      votes[k] += std::log(static_cast<double>(keyframes.size()) / static_cast<double>(hit.size()));
    }
  }
  return {votes.begin(), votes.end()};
}

TEST(InvertedIndex, WorkedExample) {
  const BinaryDescriptor zero{};
  InvertedIndex index(40);
  EXPECT_EQ(index.size(), 0u);
  // Keyframe 0 holds the feature twice: it still gets one vote.
  EXPECT_EQ(index.Add({7, 7, 8}, {Flipped(zero, 0, 40), Flipped(zero, 9, 1), zero}), 0u);
  EXPECT_EQ(index.Add({7}, {Flipped(zero, 0, 41)}), 1u);  // one bit too far
  EXPECT_EQ(index.Add({9}, {zero}), 2u);                  // another word
  EXPECT_EQ(index.Add({7, 8}, {zero, Flipped(zero, 8, 9)}), 3u);
  EXPECT_EQ(index.size(), 4u);
  // Word 7 hits keyframes 0 and 3 of four; word 8 the same; word 11 is unknown.
  const std::vector<float> votes = index.Votes({7, 8, 11}, {zero, zero, zero});
  const float weight = std::log(2.0f);
  ASSERT_EQ(votes.size(), 4u);
  EXPECT_FLOAT_EQ(votes[0], 2.0f * weight);
  EXPECT_EQ(votes[1], 0.0f);
  EXPECT_EQ(votes[2], 0.0f);
  EXPECT_FLOAT_EQ(votes[3], 2.0f * weight);
  // Word 9 hits one of four.
  EXPECT_FLOAT_EQ(index.Votes({9}, {zero})[2], std::log(4.0f));
}

TEST(InvertedIndex, EachQueryDescriptorVotesForItself) {
  const BinaryDescriptor zero{};
  InvertedIndex index(10);
  index.Add({1}, {zero});
  index.Add({2}, {zero});
  EXPECT_FLOAT_EQ(index.Votes({1, 1, 1}, {zero, zero, zero})[0], 3.0f * std::log(2.0f));
}

TEST(InvertedIndex, FeatureOfEveryKeyframeCountsNothing) {
  const BinaryDescriptor zero{};
  InvertedIndex index(0);
  for (int i = 0; i < 3; ++i) index.Add({1}, {zero});
  EXPECT_EQ(index.Votes({1}, {zero}), std::vector<float>(3, 0.0f));
}

TEST(InvertedIndex, AgreesWithBruteForce) {
  for (const int max_hamming : {0, 20, 40, 256}) {
    std::mt19937_64 engine(static_cast<uint64_t>(max_hamming));
    InvertedIndex index(max_hamming);
    std::vector<Bag> keyframes;
    for (int k = 0; k < 20; ++k) {
      keyframes.push_back(RandomBag(engine() % 40, engine));
      index.Add(keyframes.back().words, keyframes.back().descriptors);
    }
    float most = 0.0f;
    for (int q = 0; q < 20; ++q) {
      const Bag query = RandomBag(30, engine);
      const std::vector<float> votes = index.Votes(query.words, query.descriptors);
      EXPECT_EQ(votes, BruteForceVotes(keyframes, query, max_hamming));
      most = std::max(most, *std::max_element(votes.begin(), votes.end()));
    }
    EXPECT_GT(most, max_hamming > 0 ? 1.0f : -1.0f);
  }
}

TEST(InvertedIndex, OrderOfKeyframesAndFeaturesDoesNotMatter) {
  std::mt19937_64 engine(12);
  std::vector<Bag> keyframes;
  for (int k = 0; k < 15; ++k) keyframes.push_back(RandomBag(30, engine));
  const Bag query = RandomBag(30, engine);
  InvertedIndex forward(40);
  InvertedIndex backward(40);
  for (size_t k = 0; k < keyframes.size(); ++k) {
    forward.Add(keyframes[k].words, keyframes[k].descriptors);
    Bag turned = keyframes[keyframes.size() - 1 - k];
    std::reverse(turned.words.begin(), turned.words.end());
    std::reverse(turned.descriptors.begin(), turned.descriptors.end());
    backward.Add(turned.words, turned.descriptors);
  }
  std::vector<float> turned = backward.Votes(query.words, query.descriptors);
  std::reverse(turned.begin(), turned.end());
  EXPECT_EQ(forward.Votes(query.words, query.descriptors), turned);
}

TEST(InvertedIndex, EmptyIndexAndEmptyKeyframes) {
  InvertedIndex index(40);
  EXPECT_TRUE(index.Votes({1}, {BinaryDescriptor{}}).empty());
  index.Add({}, {});
  EXPECT_EQ(index.Votes({1}, {BinaryDescriptor{}}), std::vector<float>{0.0f});
  EXPECT_EQ(index.Votes({}, {}), std::vector<float>{0.0f});
}

TEST(InvertedIndex, MalformedInputChangesNothing) {
  EXPECT_THROW(InvertedIndex(-1), std::invalid_argument);
  EXPECT_THROW(InvertedIndex(257), std::invalid_argument);
  InvertedIndex index(40);
  EXPECT_THROW(index.Add({1, 2}, {BinaryDescriptor{}}), std::invalid_argument);
  EXPECT_EQ(index.size(), 0u);
  EXPECT_THROW(index.Votes({1}, {}), std::invalid_argument);
}

}  // namespace
}  // namespace covinz
