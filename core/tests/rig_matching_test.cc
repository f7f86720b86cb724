// Matching of rigs: on every instruction set of this processor the matches of OpenCV.
#include "covinz/rig_matching.h"

#include <limits>
#include <random>
#include <stdexcept>

#include <gtest/gtest.h>

namespace covinz {
namespace {

constexpr InstructionSet kAll[] = {InstructionSet::kPortable, InstructionSet::kNeon,
                                   InstructionSet::kSse42, InstructionSet::kAvx2,
                                   InstructionSet::kAvx512};

std::vector<InstructionSet> Supported() {
  std::vector<InstructionSet> supported;
  for (const InstructionSet set : kAll) {
    if (IsSupported(set)) supported.push_back(set);
  }
  return supported;
}

// Only the bits of the mask vary: with few of them, many distances are equal.
Descriptors RandomDescriptors(int rows, int cols, uint64_t seed, uint8_t mask = 0xff) {
  std::mt19937_64 engine(seed);
  return Descriptors::NullaryExpr(rows, cols,
                                  [&] { return static_cast<uint8_t>(engine() & mask); });
}

// Some of the candidates are query descriptors, changed in `num_changed` bytes.
Descriptors SomeAlike(const Descriptors& query, Descriptors cand, uint64_t seed, int num_changed) {
  std::mt19937_64 engine(seed);
  if (query.rows() == 0) return cand;
  for (Eigen::Index i = 0; i < cand.rows(); i += 2) {
    cand.row(i) = query.row(static_cast<Eigen::Index>(engine() % uint64_t(query.rows())));
    for (int k = 0; k < num_changed; ++k) {
      cand(i, static_cast<Eigen::Index>(engine() % uint64_t(cand.cols()))) ^= 1;
    }
  }
  return cand;
}

using Pairs = std::vector<std::pair<int, int>>;

Pairs AsPairs(const std::vector<Match>& matches) {
  Pairs pairs;
  for (const Match& match : matches) pairs.emplace_back(match.query, match.cand);
  return pairs;
}

// Under all combinations of options; returns how many matches there were to compare.
size_t ExpectTheMatchesOfOpenCv(const Descriptors& query, const Descriptors& cand) {
  size_t num_matches = 0;
  const PackedDescriptors packed_query(query);
  const PackedDescriptors packed_cand(cand);
  for (const DescriptorNorm norm : {DescriptorNorm::kHamming, DescriptorNorm::kL2}) {
    for (const double max_ratio : {0.8, 1.0}) {
      for (const bool mutual : {true, false}) {
        for (const double max_distance : {20.0, 1e9}) {
          const MatchingOptions options{norm, max_ratio, mutual, max_distance};
          const Pairs expected = AsPairs(MatchDescriptors(query, cand, options));
          num_matches += expected.size();
          for (const InstructionSet set : Supported()) {
            EXPECT_EQ(AsPairs(MatchPacked(packed_query, packed_cand, options, set)), expected)
                << "instruction set " << static_cast<int>(set) << ", " << query.rows() << " x "
                << cand.rows() << " of " << query.cols() << " bytes";
          }
        }
      }
    }
  }
  return num_matches;
}

TEST(InstructionSets, ThePortableOneIsEverywhereAndTheBestIsSupported) {
  EXPECT_TRUE(IsSupported(InstructionSet::kPortable));
  EXPECT_TRUE(IsSupported(BestInstructionSet()));
  EXPECT_FALSE(IsSupported(InstructionSet::kNeon) && IsSupported(InstructionSet::kAvx2));
}

// Of all numbers around the lanes of the kernels and of rows taken together.
TEST(MatchPacked, AnyNumberOfDescriptors) {
  size_t num_matches = 0;
  for (const int num_query : {0, 1, 2, 3, 5, 8, 9, 16, 31}) {
    for (const int num_cand : {0, 1, 2, 3, 4, 7, 8, 15, 16, 17, 33, 70}) {
      for (const int cols : {32, 128}) {
        const Descriptors query = RandomDescriptors(num_query, cols, 1);
        const Descriptors cand = SomeAlike(query, RandomDescriptors(num_cand, cols, 2), 3, 4);
        num_matches += ExpectTheMatchesOfOpenCv(query, cand);
      }
    }
  }
  EXPECT_GT(num_matches, 10'000u);
}

TEST(MatchPacked, DescriptorsOfAnyLength) {
  size_t num_matches = 0;
  for (const int cols : {1, 3, 4, 31, 33, 61, 64, 127, 129, 256, 1024}) {
    const Descriptors query = RandomDescriptors(41, cols, 4, 0x3f);
    const Descriptors cand = SomeAlike(query, RandomDescriptors(57, cols, 5, 0x3f), 6, 2);
    num_matches += ExpectTheMatchesOfOpenCv(query, cand);
  }
  EXPECT_GT(num_matches, 1'000u);
}

// Bytes of one or two values: nearly every nearest neighbour is one of several.
TEST(MatchPacked, TheFirstOfEquallyNearOnes) {
  size_t num_matches = 0;
  for (const uint8_t mask : {0x01, 0x80, 0x00}) {
    for (const int cols : {1, 2, 32, 128}) {
      num_matches += ExpectTheMatchesOfOpenCv(RandomDescriptors(83, cols, 7, mask),
                                              RandomDescriptors(90, cols, 8, mask));
    }
  }
  EXPECT_GT(num_matches, 1'000u);
}

TEST(MatchPacked, Duplicates) {
  Descriptors query = RandomDescriptors(60, 32, 9);
  query.bottomRows(30) = query.topRows(30);
  Descriptors cand(120, 32);
  cand << query, query.colwise().reverse();
  EXPECT_GT(ExpectTheMatchesOfOpenCv(query, cand), 100u);
}

// A squared distance of 1,024 bytes leaves five bits of a key to the index, one of 128 bytes eight.
TEST(MatchPacked, MoreDescriptorsThanAKeyCanCount) {
  for (const uint8_t mask : {0x01, 0x0f}) {
    const Descriptors query = RandomDescriptors(37, 1024, 10, mask);
    const Descriptors cand = SomeAlike(query, RandomDescriptors(550, 1024, 11, mask), 12, 3);
    EXPECT_GT(ExpectTheMatchesOfOpenCv(query, cand), 100u);
  }
  const Descriptors query = RandomDescriptors(530, 128, 13, 0x01);
  EXPECT_GT(ExpectTheMatchesOfOpenCv(query, RandomDescriptors(60, 128, 14, 0x01)), 500u);
}

TEST(MatchPacked, AsManyAsAnImageHas) {
  const Descriptors query = RandomDescriptors(1000, 32, 15);
  const Descriptors cand = SomeAlike(query, RandomDescriptors(1003, 32, 16), 17, 10);
  const MatchingOptions options;
  const Pairs expected = AsPairs(MatchDescriptors(query, cand, options));
  EXPECT_GT(expected.size(), 300u);
  for (const InstructionSet set : Supported()) {
    const auto matches =
        MatchPacked(PackedDescriptors(query), PackedDescriptors(cand), options, set);
    EXPECT_EQ(AsPairs(matches), expected);
  }
}

// Where the partial sums of the kernels are largest, by the definition in integers.
TEST(MatchPacked, DistancesOfExtremeBytesAreExact) {
  const int cols = 128;
  Descriptors query = RandomDescriptors(40, cols, 18, 0x01) * 255;
  Descriptors cand = RandomDescriptors(50, cols, 19, 0x01) * 255;
  query.row(3).setConstant(255);
  cand.row(5).setConstant(255);
  cand.row(6).setConstant(128);
  cand.row(7).setConstant(127);
  cand.row(8).setZero();
  Pairs expected;
  for (Eigen::Index q = 0; q < query.rows(); ++q) {
    Eigen::Index nearest = 0;
    (cand.cast<int>().rowwise() - query.row(q).cast<int>())
        .rowwise()
        .squaredNorm()
        .minCoeff(&nearest);
    expected.emplace_back(static_cast<int>(q), static_cast<int>(nearest));
  }
  const MatchingOptions options{DescriptorNorm::kL2, 1.0, false, 1e9};
  for (const InstructionSet set : Supported()) {
    const auto matches =
        MatchPacked(PackedDescriptors(query), PackedDescriptors(cand), options, set);
    EXPECT_EQ(AsPairs(matches), expected);
  }
}

// The squares 7,998,076 and 7,998,075 have the same root in single precision.
TEST(MatchPacked, IsMoreExactThanOpenCvBeyond2048) {
  const Descriptors query = Descriptors::Zero(1, 128);
  Descriptors cand = Descriptors::Zero(2, 128);
  cand.leftCols(123).setConstant(255);
  cand(0, 127) = 1;
  const MatchingOptions options{DescriptorNorm::kL2, 1.0, true, 1e9};
  EXPECT_EQ(AsPairs(MatchDescriptors(query, cand, options)), (Pairs{{0, 0}}));
  for (const InstructionSet set : Supported()) {
    const auto matches =
        MatchPacked(PackedDescriptors(query), PackedDescriptors(cand), options, set);
    EXPECT_EQ(AsPairs(matches), (Pairs{{0, 1}}));
  }
}

TEST(MatchPacked, FeaturesWithoutABearingTakeNoPart) {
  const Descriptors query = RandomDescriptors(50, 32, 20);
  const Descriptors cand = SomeAlike(query, RandomDescriptors(60, 32, 21), 22, 3);
  Points3 query_bearings = Points3::Ones(50, 3);
  Points3 cand_bearings = Points3::Ones(60, 3);
  std::vector<int> query_rows, cand_rows;
  for (int i = 0; i < 60; ++i) {
    if (i < 50 && i % 3 == 0) query_bearings(i, i % 2) = std::numeric_limits<double>::quiet_NaN();
    if (i < 50 && i % 3 != 0) query_rows.push_back(i);
    if (i % 5 == 0) cand_bearings(i, 2) = std::numeric_limits<double>::infinity();
    if (i % 5 != 0) cand_rows.push_back(i);
  }
  Pairs expected;
  for (const Match& match : MatchDescriptors(query(query_rows, Eigen::all),
                                             cand(cand_rows, Eigen::all), MatchingOptions())) {
    expected.emplace_back(query_rows[size_t(match.query)], cand_rows[size_t(match.cand)]);
  }
  ASSERT_GT(expected.size(), 5u);
  const PackedDescriptors packed_query(query, query_bearings);
  const PackedDescriptors packed_cand(cand, cand_bearings);
  EXPECT_EQ(packed_query.rows(), query_rows);
  for (const InstructionSet set : Supported()) {
    EXPECT_EQ(AsPairs(MatchPacked(packed_query, packed_cand, MatchingOptions(), set)), expected);
  }
  const Points3 nowhere = Points3::Constant(50, 3, std::numeric_limits<double>::quiet_NaN());
  EXPECT_TRUE(
      MatchPacked(PackedDescriptors(query, nowhere), packed_cand, MatchingOptions()).empty());
}

TEST(MatchRigs, EveryPairWithTheQueryOutermost) {
  std::vector<Descriptors> query, cand;
  std::vector<PackedDescriptors> packed_query, packed_cand;
  for (int i = 0; i < 2; ++i) {
    query.push_back(RandomDescriptors(30 + i, 32, uint64_t(23 + i)));
    packed_query.emplace_back(query.back());
  }
  for (int i = 0; i < 3; ++i) {
    cand.push_back(SomeAlike(query[size_t(i % 2)], RandomDescriptors(40, 32, 25), uint64_t(i), 2));
    packed_cand.emplace_back(cand.back());
  }
  const auto matches = MatchRigs(packed_query, packed_cand, MatchingOptions());
  ASSERT_EQ(matches.size(), 6u);
  for (size_t q = 0; q < 2; ++q) {
    for (size_t c = 0; c < 3; ++c) {
      EXPECT_EQ(AsPairs(matches[3 * q + c]),
                AsPairs(MatchDescriptors(query[q], cand[c], MatchingOptions())));
    }
  }
  EXPECT_TRUE(MatchRigs({}, packed_cand, MatchingOptions()).empty());
}

TEST(MatchPacked, RejectsMisuse) {
  const PackedDescriptors orb(RandomDescriptors(5, 32, 1));
  const PackedDescriptors sift(RandomDescriptors(5, 128, 1));
  EXPECT_THROW(MatchPacked(orb, sift, MatchingOptions()), std::invalid_argument);
  EXPECT_THROW(PackedDescriptors(RandomDescriptors(5, 1025, 1)), std::invalid_argument);
  EXPECT_THROW(PackedDescriptors(RandomDescriptors(5, 32, 1), Points3::Ones(4, 3)),
               std::invalid_argument);
  MatchingOptions options;
  options.max_ratio = 0.0;
  EXPECT_THROW(MatchPacked(orb, orb, options), std::invalid_argument);
  for (const InstructionSet set : kAll) {
    if (IsSupported(set)) continue;
    EXPECT_THROW(MatchPacked(orb, orb, MatchingOptions(), set), std::invalid_argument);
  }
  EXPECT_TRUE(MatchPacked(PackedDescriptors(Descriptors(3, 0)),
                          PackedDescriptors(Descriptors(4, 0)), MatchingOptions())
                  .empty());
}

}  // namespace
}  // namespace covinz
