// Descriptors of 128 bytes (SIFT), compared by their Euclidean distance.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace covinz {

using ByteDescriptor = std::array<uint8_t, 128>;

// Square of the Euclidean distance, at most 128 * 255^2.
inline int SquaredDistance(const ByteDescriptor& a, const ByteDescriptor& b) {
  int sum = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    const int difference = static_cast<int>(a[i]) - static_cast<int>(b[i]);
    sum += difference * difference;
  }
  return sum;
}

// Index of the candidate nearest to the query, the first one of equals; num_candidates > 0.
size_t NearestDescriptor(const ByteDescriptor& query,
                         const ByteDescriptor* candidates,
                         size_t num_candidates);

}  // namespace covinz
