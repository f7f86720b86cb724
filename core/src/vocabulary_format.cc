// Bytes of a vocabulary; the layout is stated at Vocabulary::ToBytes.
#include <algorithm>
#include <array>
#include <cstring>
#include <stdexcept>

#include "covinz/vocabulary.h"

namespace covinz {
namespace {

constexpr std::array<uint8_t, 8> kMagic = {'c', 'o', 'v', 'i', 'n', 'z', '-', 'v'};
constexpr uint32_t kVersion = 1;
constexpr size_t kHeaderBytes = kMagic.size() + 3 * sizeof(uint32_t);
constexpr size_t kNodeBytes = kDescriptorBytes + 1;

void Require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(std::string("Vocabulary bytes: ") + message);
}

std::array<uint8_t, 4> LittleEndian(uint32_t value) {
  return {static_cast<uint8_t>(value), static_cast<uint8_t>(value >> 8),
          static_cast<uint8_t>(value >> 16), static_cast<uint8_t>(value >> 24)};
}

uint32_t FromLittleEndian(const uint8_t* bytes) {
  return static_cast<uint32_t>(bytes[0]) | static_cast<uint32_t>(bytes[1]) << 8 |
         static_cast<uint32_t>(bytes[2]) << 16 | static_cast<uint32_t>(bytes[3]) << 24;
}

static_assert(sizeof(float) == sizeof(uint32_t));

uint32_t BitsOf(float value) {
  uint32_t bits;
  std::memcpy(&bits, &value, sizeof(bits));
  return bits;
}

float FloatOf(uint32_t bits) {
  float value;
  std::memcpy(&value, &bits, sizeof(value));
  return value;
}

}  // namespace

std::vector<uint8_t> Vocabulary::ToBytes() const {
  std::vector<uint8_t> bytes(kMagic.begin(), kMagic.end());
  const auto append = [&bytes](uint32_t value) {
    const std::array<uint8_t, 4> encoded = LittleEndian(value);
    bytes.insert(bytes.end(), encoded.begin(), encoded.end());
  };
  append(kVersion);
  append(static_cast<uint32_t>(nodes_.size()));
  append(num_words());
  const auto* centroids = reinterpret_cast<const uint8_t*>(centroids_.data());
  bytes.insert(bytes.end(), centroids, centroids + kDescriptorBytes * centroids_.size());
  for (const VocabularyNode& node : nodes_) {
    bytes.push_back(static_cast<uint8_t>(node.num_children));
  }
  for (const float weight : idf_) append(BitsOf(weight));
  return bytes;
}

Vocabulary Vocabulary::FromBytes(const uint8_t* bytes, size_t num_bytes) {
  Require(num_bytes >= kHeaderBytes, "too short");
  Require(std::equal(kMagic.begin(), kMagic.end(), bytes), "not a vocabulary");
  const uint8_t* cursor = bytes + kMagic.size();
  Require(FromLittleEndian(cursor) == kVersion, "unknown version");
  const size_t num_nodes = FromLittleEndian(cursor + 4);
  const size_t num_words = FromLittleEndian(cursor + 8);
  // Both counts are 32 bits wide, so the expected length cannot overflow.
  Require(num_bytes == kHeaderBytes + kNodeBytes * num_nodes + sizeof(float) * num_words,
          "length differs from the header's counts");

  cursor = bytes + kHeaderBytes;
  std::vector<BinaryDescriptor> centroids = BinaryDescriptorsFromBytes(cursor, num_nodes);
  cursor += kDescriptorBytes * num_nodes;
  const std::vector<uint8_t> num_children(cursor, cursor + num_nodes);
  cursor += num_nodes;
  std::vector<float> idf(num_words);
  for (size_t i = 0; i < num_words; ++i) idf[i] = FloatOf(FromLittleEndian(cursor + 4 * i));
  return Vocabulary(std::move(centroids), num_children, std::move(idf));
}

}  // namespace covinz
