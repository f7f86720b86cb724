// Draws are reproducible, in range, unbiased and without repetition.
#include "covinz/random.h"

#include <algorithm>
#include <set>

#include <gtest/gtest.h>

namespace covinz {
namespace {

TEST(Random, KnownSequence) {
  // The standard fixes mt19937_64: its 10000th value from the default seed 5489.
  Random random(5489);
  int last = 0;
  for (int i = 0; i < 10000; ++i) last = random.Below(1000);
  EXPECT_EQ(last, 9981545732273789042ULL % 1000);
}

TEST(Random, BelowIsUniform) {
  Random random(1);
  std::vector<int> counts(7, 0);
  for (int i = 0; i < 70000; ++i) ++counts.at(static_cast<size_t>(random.Below(7)));
  // Six standard deviations of a binomial count.
  for (const int count : counts) EXPECT_NEAR(count, 10000, 560);
}

TEST(Random, DrawsAreDistinctAndKeepWhatIsThere) {
  Random random(2);
  for (int trial = 0; trial < 100; ++trial) {
    std::vector<int> sample{3, 12};
    random.DrawDistinct(0, 10, 9, sample);
    EXPECT_EQ(sample.size(), 11u);
    EXPECT_EQ(std::set<int>(sample.begin(), sample.end()).size(), 11u);
    EXPECT_EQ(sample[1], 12);
    EXPECT_LT(*std::max_element(sample.begin() + 2, sample.end()), 10);
  }
}

TEST(Random, StreamsDiffer) {
  std::set<uint64_t> seeds;
  for (uint64_t seed = 0; seed < 50; ++seed) {
    for (uint64_t stream = 0; stream < 50; ++stream) seeds.insert(DeriveSeed(seed, stream));
  }
  EXPECT_EQ(seeds.size(), 2500u);
}

}  // namespace
}  // namespace covinz
