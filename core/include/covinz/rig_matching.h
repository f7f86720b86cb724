// Matching of all camera pairs of two rigs: the matches of MatchDescriptors, many times faster.
#pragma once

#include <cstdint>
#include <vector>

#include "covinz/camera.h"
#include "covinz/instruction_set.h"
#include "covinz/matching.h"

namespace covinz {

// The descriptors of one image, prepared once for matching with any number of others: groups of
// four bytes, interleaved so that one load brings the same group of sixteen descriptors.
class PackedDescriptors {
 public:
  static constexpr size_t kLanes = 16;
  // Descriptors are filled up with zeros to a multiple of this many bytes ...
  static constexpr size_t kStepBytes = 32;
  // ... and are no longer than this, so that every distance leaves room for an index in 32 bits.
  static constexpr size_t kMaxBytes = 1024;

  // Throws std::invalid_argument for descriptors longer than kMaxBytes.
  explicit PackedDescriptors(const Descriptors& descriptors);

  // Without the rows whose bearing is not finite: they take no part in matching. Throws
  // std::invalid_argument also unless there is one bearing a descriptor.
  PackedDescriptors(const Descriptors& descriptors, const Points3& bearings);

  size_t size() const { return rows_.size(); }
  size_t num_bytes() const { return num_bytes_; }
  // Row in the descriptors given, of each one kept; ascending.
  const std::vector<int>& rows() const { return rows_; }

  // groups()[(i / 16 * num_groups() + g) * 16 + i % 16] is bytes 4 g to 4 g + 3 of descriptor i.
  const std::vector<uint32_t>& groups() const { return groups_; }
  size_t num_groups() const { return num_groups_; }
  // The same bytes one descriptor after the other, num_groups() / 2 words each.
  const std::vector<uint64_t>& words() const { return words_; }
  // Sums over the bytes of each descriptor and over their squares, filled up with zeros.
  const std::vector<uint32_t>& sums() const { return sums_; }
  const std::vector<uint32_t>& squared_norms() const { return squared_norms_; }

 private:
  void Pack(const Descriptors& descriptors);

  std::vector<int> rows_;
  size_t num_bytes_;
  size_t num_groups_;
  std::vector<uint32_t> groups_;
  std::vector<uint64_t> words_;
  std::vector<uint32_t> sums_;
  std::vector<uint32_t> squared_norms_;
};

// The matches of MatchDescriptors, in rows of the descriptors that were packed, ascending in the
// query row; the same ones with every instruction set. Distances are computed once: one pass yields
// the nearest and the second nearest of every query descriptor and the nearest of every candidate
// descriptor (the mutual check). SSE4.2 and AVX2 instead bound the Hamming distances of 32 bytes
// from below, by looking nibbles up, and compute those only that could make or break a match. The
// first of equally near ones is the nearest, as in OpenCV.
//
// Distances are exact integers; OpenCV rounds those of kL2 to single precision, so beyond 2048
// (descriptors of SIFT are at most 1024 apart) it takes the first of some that differ by less than
// its precision.
//
// Memory grows with the number of descriptors, not of pairs. Throws std::invalid_argument when the
// descriptors differ in length, the options are out of range or the processor lacks the instruction
// set.
//
// The NEON kernels are tested in emulation (make core-neon), never timed.
//
// Source: COVINS-G, III-B2 (brute force); Lowe, IJCV 2004 (ratio); Mula, Kurz, Lemire, "Faster
// population counts using AVX2 instructions", The Computer Journal 2018 (kernels).
std::vector<Match> MatchPacked(const PackedDescriptors& query,
                               const PackedDescriptors& cand,
                               const MatchingOptions& options,
                               InstructionSet instruction_set = BestInstructionSet());

// The matches of every camera pair, the query camera outermost.
std::vector<std::vector<Match>> MatchRigs(const std::vector<PackedDescriptors>& query,
                                          const std::vector<PackedDescriptors>& cand,
                                          const MatchingOptions& options,
                                          InstructionSet instruction_set = BestInstructionSet());

}  // namespace covinz
