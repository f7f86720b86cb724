// The tf-idf L1 score: worked examples and the definition.
#include "covinz/tf_idf_index.h"

#include <cmath>
#include <map>
#include <random>
#include <stdexcept>

#include <gtest/gtest.h>

namespace covinz {
namespace {

// A flat vocabulary with the given idf weights; the centroids do not matter here.
Vocabulary WithIdf(const std::vector<float>& idf) {
  std::vector<uint8_t> num_children(idf.size() + 1, 0);
  num_children[0] = static_cast<uint8_t>(idf.size());
  return Vocabulary(std::vector<BinaryDescriptor>(idf.size() + 1), num_children, idf);
}

std::map<uint32_t, double> BagOf(const std::vector<uint32_t>& words,
                                 const std::vector<float>& idf) {
  std::map<uint32_t, double> bag;
  double sum = 0.0;
  for (const uint32_t word : words) {
    bag[word] += static_cast<double>(idf[word]);
    sum += static_cast<double>(idf[word]);
  }
  for (auto& [word, weight] : bag) weight /= sum;
  return bag;
}

// 1 - |v - w|_1 / 2, literally.
double ScoreOf(std::map<uint32_t, double> v, std::map<uint32_t, double> w, size_t num_words) {
  double l1 = 0.0;
  for (uint32_t word = 0; word < num_words; ++word) l1 += std::abs(v[word] - w[word]);
  return 1.0 - 0.5 * l1;
}

TEST(TfIdfIndex, WorkedExample) {
  TfIdfIndex index(WithIdf({1.0f, 2.0f, 3.0f}));
  EXPECT_EQ(index.Add({0, 0, 1}), 0u);     // (1/2, 1/2, 0)
  EXPECT_EQ(index.Add({2, 2, 2, 2}), 1u);  // (0, 0, 1)
  EXPECT_EQ(index.Add({0, 2}), 2u);        // (1/4, 0, 3/4)
  EXPECT_EQ(index.size(), 3u);
  // Query (1/4, 0, 3/4): |v - w|_1 is 3/2, 1/2 and 0.
  const std::vector<float> scores = index.Scores({2, 0});
  ASSERT_EQ(scores.size(), 3u);
  EXPECT_FLOAT_EQ(scores[0], 0.25f);
  EXPECT_FLOAT_EQ(scores[1], 0.75f);
  EXPECT_FLOAT_EQ(scores[2], 1.0f);
}

TEST(TfIdfIndex, AgreesWithTheDefinition) {
  std::mt19937_64 engine(1);
  const size_t num_words = 40;
  std::vector<float> idf;
  for (size_t i = 0; i < num_words; ++i) idf.push_back(0.1f + 0.1f * static_cast<float>(i));
  TfIdfIndex index(WithIdf(idf));
  const auto draw = [&] {
    std::vector<uint32_t> words;
    for (int i = 0; i < 25; ++i) words.push_back(static_cast<uint32_t>(engine() % num_words));
    return words;
  };
  std::vector<std::vector<uint32_t>> keyframes;
  for (int k = 0; k < 20; ++k) {
    keyframes.push_back(draw());
    index.Add(keyframes.back());
  }
  const std::vector<uint32_t> query = draw();
  const std::vector<float> scores = index.Scores(query);
  for (size_t k = 0; k < keyframes.size(); ++k) {
    EXPECT_NEAR(scores[k], ScoreOf(BagOf(query, idf), BagOf(keyframes[k], idf), num_words), 1e-6);
  }
}

TEST(TfIdfIndex, ScoreIsSymmetricAndIgnoresOrder) {
  const Vocabulary vocabulary = WithIdf({1.0f, 2.0f, 3.0f});
  TfIdfIndex one(vocabulary);
  TfIdfIndex other(vocabulary);
  one.Add({0, 1, 1, 2});
  other.Add({2, 0, 0});
  EXPECT_EQ(one.Scores({0, 2, 0}), other.Scores({1, 0, 2, 1}));
}

TEST(TfIdfIndex, WordsOfEveryImageSayNothing) {
  TfIdfIndex index(WithIdf({0.0f, 1.0f}));
  index.Add({0, 0, 0});
  index.Add({0, 1});
  index.Add({});
  EXPECT_EQ(index.Scores({0, 1}), (std::vector<float>{0.0f, 1.0f, 0.0f}));
  EXPECT_EQ(index.Scores({0}), (std::vector<float>{0.0f, 0.0f, 0.0f}));
}

TEST(TfIdfIndex, UnknownWordsAreRejected) {
  TfIdfIndex index(WithIdf({1.0f, 1.0f}));
  EXPECT_THROW(index.Add({0, 2}), std::invalid_argument);
  EXPECT_EQ(index.size(), 0u);
  EXPECT_THROW(index.Scores({4000000000u}), std::invalid_argument);
}

}  // namespace
}  // namespace covinz
