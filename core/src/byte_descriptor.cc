// Nearest neighbour of 128-byte descriptors.
#include "covinz/byte_descriptor.h"

namespace covinz {

size_t NearestDescriptor(const ByteDescriptor& query,
                         const ByteDescriptor* candidates,
                         size_t num_candidates) {
  size_t nearest = 0;
  int least = SquaredDistance(query, candidates[0]);
  for (size_t i = 1; i < num_candidates; ++i) {
    const int distance = SquaredDistance(query, candidates[i]);
    if (distance < least) {
      least = distance;
      nearest = i;
    }
  }
  return nearest;
}

}  // namespace covinz
