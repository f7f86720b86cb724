// Generated binary descriptors: clusters of known centres.
#pragma once

#include <cstdint>
#include <random>
#include <vector>

#include "covinz/binary_descriptor.h"

namespace covinz {

inline BinaryDescriptor RandomDescriptor(std::mt19937_64& engine) {
  return {engine(), engine(), engine(), engine()};
}

// The descriptor with num_bits bits from first_bit on flipped.
inline BinaryDescriptor Flipped(BinaryDescriptor descriptor, size_t first_bit, size_t num_bits) {
  for (size_t bit = first_bit; bit < first_bit + num_bits; ++bit) {
    descriptor[bit % 256 / 64] ^= uint64_t{1} << (bit % 64);
  }
  return descriptor;
}

// num_clusters * per_cluster descriptors, cluster after cluster, each with up to max_noise bits
// flipped. Random centres are about 128 bits apart.
inline std::vector<BinaryDescriptor> ClusteredDescriptors(size_t num_clusters,
                                                          size_t per_cluster,
                                                          size_t max_noise,
                                                          uint64_t seed) {
  std::mt19937_64 engine(seed);
  std::vector<BinaryDescriptor> descriptors;
  for (size_t c = 0; c < num_clusters; ++c) {
    const BinaryDescriptor centre = RandomDescriptor(engine);
    for (size_t i = 0; i < per_cluster; ++i) {
      BinaryDescriptor descriptor = centre;
      for (size_t k = 0; k < max_noise; ++k) descriptor = Flipped(descriptor, engine() % 256, 1);
      descriptors.push_back(descriptor);
    }
  }
  return descriptors;
}

}  // namespace covinz
