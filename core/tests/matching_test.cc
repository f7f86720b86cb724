// Matching: known nearest neighbours, ratio, mutual check, limits, too few descriptors, bad input.
#include "covinz/matching.h"

#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace covinz {
namespace {

Descriptors RandomDescriptors(int rows, int cols, uint64_t seed) {
  std::mt19937_64 engine(seed);
  return Descriptors::NullaryExpr(rows, cols, [&] { return static_cast<uint8_t>(engine()); });
}

// A descriptor of one byte value throughout: distances are easy to count.
Descriptors Rows(const std::vector<int>& values) {
  Descriptors descriptors(static_cast<Eigen::Index>(values.size()), 32);
  for (size_t i = 0; i < values.size(); ++i) {
    descriptors.row(static_cast<Eigen::Index>(i)).setConstant(static_cast<uint8_t>(values[i]));
  }
  return descriptors;
}

std::vector<std::pair<int, int>> AsPairs(const std::vector<Match>& matches) {
  std::vector<std::pair<int, int>> pairs;
  for (const Match& match : matches) pairs.emplace_back(match.query, match.cand);
  return pairs;
}

using Expected = std::vector<std::pair<int, int>>;

TEST(MatchDescriptors, FindsAPermutation) {
  const Descriptors query = RandomDescriptors(200, 32, 1);
  Descriptors cand = query.colwise().reverse();
  for (Eigen::Index i = 0; i < cand.rows(); ++i) cand(i, i % 32) ^= 0x11;  // two bits of noise
  for (const DescriptorNorm norm : {DescriptorNorm::kHamming, DescriptorNorm::kL2}) {
    MatchingOptions options;
    options.norm = norm;
    const std::vector<Match> matches = MatchDescriptors(query, cand, options);
    ASSERT_EQ(matches.size(), 200u);
    for (int i = 0; i < 200; ++i) {
      EXPECT_EQ(matches[static_cast<size_t>(i)].query, i);
      EXPECT_EQ(matches[static_cast<size_t>(i)].cand, 199 - i);
    }
  }
}

// By the definition, a distance at a time.
Expected MatchesByDefinition(const Descriptors& query,
                             const Descriptors& cand,
                             const MatchingOptions& options) {
  const auto distance = [&](Eigen::Index q, Eigen::Index c) {
    double sum = 0.0;
    for (Eigen::Index k = 0; k < query.cols(); ++k) {
      const int a = query(q, k);
      const int b = cand(c, k);
      sum +=
          options.norm == DescriptorNorm::kHamming ? __builtin_popcount(a ^ b) : (a - b) * (a - b);
    }
    return options.norm == DescriptorNorm::kHamming ? sum : std::sqrt(sum);
  };
  Expected matches;
  for (Eigen::Index q = 0; q < query.rows(); ++q) {
    std::vector<std::pair<double, Eigen::Index>> order;
    for (Eigen::Index c = 0; c < cand.rows(); ++c) order.emplace_back(distance(q, c), c);
    std::sort(order.begin(), order.end());
    const auto [nearest, c] = order[0];
    bool kept = nearest <= options.max_distance;
    if (options.max_ratio < 1.0) {
      kept = kept && order.size() > 1 && nearest < options.max_ratio * order[1].first;
    }
    for (Eigen::Index other = 0; options.mutual && other < query.rows(); ++other) {
      const double back = distance(other, c);
      kept = kept && (back > nearest || (back == nearest && other >= q));
    }
    if (kept) matches.emplace_back(static_cast<int>(q), static_cast<int>(c));
  }
  return matches;
}

// Two-valued bytes give many equal distances: the first of equals is the nearest.
TEST(MatchDescriptors, AgreesWithTheDefinition) {
  size_t num_matches = 0;
  for (const int cols : {1, 8, 31, 32, 61}) {
    for (const uint8_t mask : {0x01, 0xff}) {
      Descriptors query = RandomDescriptors(40, cols, 5);
      Descriptors cand = RandomDescriptors(50, cols, 6);
      cand.topRows(20) = query.middleRows(10, 20);
      for (Descriptors* d : {&query, &cand}) {
        *d = d->unaryExpr([mask](uint8_t byte) { return static_cast<uint8_t>(byte & mask); });
      }
      for (const double max_ratio : {0.8, 1.0}) {
        for (const bool mutual : {true, false}) {
          for (const DescriptorNorm norm : {DescriptorNorm::kHamming, DescriptorNorm::kL2}) {
            const MatchingOptions options{norm, max_ratio, mutual, 90.0};
            const Expected expected = MatchesByDefinition(query, cand, options);
            EXPECT_EQ(AsPairs(MatchDescriptors(query, cand, options)), expected);
            num_matches += expected.size();
          }
        }
      }
    }
  }
  EXPECT_GT(num_matches, 500u);
}

TEST(MatchDescriptors, RatioOfBestToSecond) {
  // From 0x00: 0x01 is 32 bits away, 0x03 is 64 bits; ratio 0.5.
  MatchingOptions options;
  options.max_ratio = 0.51;
  EXPECT_EQ(AsPairs(MatchDescriptors(Rows({0x00}), Rows({0x03, 0x01}), options)),
            (Expected{{0, 1}}));
  options.max_ratio = 0.5;
  EXPECT_TRUE(MatchDescriptors(Rows({0x00}), Rows({0x03, 0x01}), options).empty());
}

TEST(MatchDescriptors, MutualNearestOnly) {
  // Both queries prefer 0x01; it prefers the second.
  MatchingOptions options;
  const Descriptors query = Rows({0x00, 0x01});
  const Descriptors cand = Rows({0x01, 0xff});
  EXPECT_EQ(AsPairs(MatchDescriptors(query, cand, options)), (Expected{{1, 0}}));
  options.mutual = false;
  EXPECT_EQ(AsPairs(MatchDescriptors(query, cand, options)), (Expected{{0, 0}, {1, 0}}));
}

TEST(MatchDescriptors, LargestDistance) {
  MatchingOptions options;
  options.max_distance = 31.0;
  EXPECT_TRUE(MatchDescriptors(Rows({0x00}), Rows({0x01, 0xff}), options).empty());
  options.max_distance = 32.0;
  EXPECT_EQ(MatchDescriptors(Rows({0x00}), Rows({0x01, 0xff}), options).size(), 1u);
}

TEST(MatchDescriptors, FewerThanTwoDescriptors) {
  const Descriptors many = RandomDescriptors(10, 32, 3);
  const Descriptors one = many.topRows(1);
  const Descriptors none(0, 32);
  MatchingOptions options;
  EXPECT_TRUE(MatchDescriptors(many, none, options).empty());
  EXPECT_TRUE(MatchDescriptors(none, many, options).empty());
  EXPECT_TRUE(MatchDescriptors(none, Descriptors(0, 0), options).empty());
  EXPECT_TRUE(MatchDescriptors(many, one, options).empty());  // no second neighbour
  EXPECT_EQ(MatchDescriptors(one, many, options).size(), 1u);
  options.max_ratio = 1.0;
  EXPECT_EQ(AsPairs(MatchDescriptors(many, one, options)), (Expected{{0, 0}}));
}

TEST(MatchDescriptors, RejectsMisuse) {
  EXPECT_THROW(MatchDescriptors(RandomDescriptors(5, 32, 1), RandomDescriptors(5, 64, 1), {}),
               std::invalid_argument);
  MatchingOptions options;
  options.max_ratio = 0.0;
  EXPECT_THROW(options.Check(), std::invalid_argument);
  options = {};
  options.max_ratio = 1.1;
  EXPECT_THROW(options.Check(), std::invalid_argument);
  options = {};
  options.max_distance = -1.0;
  EXPECT_THROW(options.Check(), std::invalid_argument);
}

}  // namespace
}  // namespace covinz
