// Matching of descriptors of 256 bits by kernels that look distances up (match_lookups.h).
#pragma once

#include <cstdint>
#include <vector>

#include "covinz/rig_matching.h"
#include "match_kernels.h"

namespace covinz {

// The descriptors of an image as NibbleView has them.
class NibbledDescriptors {
 public:
  struct alignas(64) Line {
    uint8_t bytes[64];
  };

  // Of descriptors of at most 32 bytes, which must outlive this.
  explicit NibbledDescriptors(const PackedDescriptors& descriptors);

  size_t size() const { return descriptors_->size(); }
  int row(size_t i) const { return descriptors_->rows()[i]; }
  const uint64_t* Words(size_t i) const { return descriptors_->words().data() + 4 * i; }
  NibbleView View() const;

 private:
  const PackedDescriptors* descriptors_;
  size_t num_padded_;
  std::vector<Line> lines_;
};

// The matches of MatchPacked for kHamming. Rows look for their nearest candidate within
// max_distance alone; the mutual check asks only the candidates of rows that passed.
std::vector<Match> MatchFiltered(const NibbledDescriptors& query,
                                 const NibbledDescriptors& cand,
                                 const MatchingOptions& options,
                                 void (*find_nearest)(NearestTile*));

}  // namespace covinz
