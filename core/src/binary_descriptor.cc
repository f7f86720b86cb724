// Nearest neighbour of 256-bit descriptors.
#include "covinz/binary_descriptor.h"

namespace covinz {

COVINZ_POPCNT_CLONES
size_t NearestDescriptor(const BinaryDescriptor& query,
                         const BinaryDescriptor* candidates,
                         size_t num_candidates) {
  size_t nearest = 0;
  int least = HammingDistance(query, candidates[0]);
  for (size_t i = 1; i < num_candidates; ++i) {
    const int distance = HammingDistance(query, candidates[i]);
    if (distance < least) {
      least = distance;
      nearest = i;
    }
  }
  return nearest;
}

}  // namespace covinz
