// Descriptor matching between two keyframes.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace covinz {

// One descriptor a row: 32 bytes of ORB, 128 of SIFT.
using Descriptors = Eigen::Matrix<uint8_t, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

enum class DescriptorNorm {
  kHamming,  // binary descriptors: ORB
  kL2        // descriptors of numbers: SIFT
};

// Options of MatchDescriptors.
struct MatchingOptions {
  DescriptorNorm norm = DescriptorNorm::kHamming;
  // Best distance below this part of the second best; 1 turns the test off. [Lowe 2004; 0.8 as in
  // the public COVINS code]
  double max_ratio = 0.8;
  // Keep a match only if each descriptor is the other's nearest. [the paper says brute force only;
  // without this one keypoint can take part in many matches]
  bool mutual = true;
  // Largest distance of a match; the default is for ORB, in bits. [a quarter of the 256 bits; the
  // public code uses 40 for ORB and 500 for SIFT, the paper names no limit]
  double max_distance = 64;

  void Check() const;  // throws std::invalid_argument
};

struct Match {
  int query;  // rows of the descriptors
  int cand;
};

// Brute-force matches, ascending in the query row. A descriptor without a second neighbour cannot
// pass the ratio test. Throws std::invalid_argument when the descriptors differ in length.
//
// Source: COVINS-G, III-B2 (brute force); Lowe, "Distinctive image features from scale-invariant
// keypoints", IJCV 2004 (ratio).
std::vector<Match> MatchDescriptors(const Descriptors& query,
                                    const Descriptors& cand,
                                    const MatchingOptions& options);

}  // namespace covinz
