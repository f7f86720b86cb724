// 256-bit binary descriptors (ORB) and their Hamming distance.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

// The compiler makes two versions of a function marked so, and the loader picks the one with
// the POPCNT instruction where the processor has it (four times faster); the baseline build
// stays runnable everywhere. Other compilers and architectures need no help.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define COVINZ_POPCNT_CLONES __attribute__((target_clones("popcnt", "default")))
#else
#define COVINZ_POPCNT_CLONES
#endif

namespace covinz {

inline constexpr size_t kDescriptorBytes = 32;

// The bytes as they come from the extractor, in four words; the order of bits is irrelevant.
using BinaryDescriptor = std::array<uint64_t, 4>;
static_assert(sizeof(BinaryDescriptor) == kDescriptorBytes);

// Number of differing bits.
template <size_t kWords>
inline int HammingDistance(const std::array<uint64_t, kWords>& a,
                           const std::array<uint64_t, kWords>& b) {
  int distance = 0;
  for (size_t i = 0; i < kWords; ++i) distance += __builtin_popcountll(a[i] ^ b[i]);
  return distance;
}

// Descriptors, of any kind, of num_descriptors * sizeof(Descriptor) bytes.
template <typename Descriptor>
std::vector<Descriptor> DescriptorsFromBytes(const uint8_t* bytes, size_t num_descriptors) {
  std::vector<Descriptor> descriptors(num_descriptors);
  if (num_descriptors > 0) {
    std::memcpy(descriptors.data(), bytes, num_descriptors * sizeof(Descriptor));
  }
  return descriptors;
}

// Index of the candidate nearest to the query, the first one of equals; num_candidates > 0.
size_t NearestDescriptor(const BinaryDescriptor& query,
                         const BinaryDescriptor* candidates,
                         size_t num_candidates);

}  // namespace covinz
