// Bytes of a vocabulary; the layout is stated at Vocabulary::ToBytes.
#include <algorithm>
#include <array>
#include <cstring>
#include <stdexcept>
#include <type_traits>
#include <utility>

#include "covinz/vocabulary.h"

namespace covinz {
namespace {

constexpr std::array<uint8_t, 8> kMagic = {'c', 'o', 'v', 'i', 'n', 'z', '-', 'v'};
constexpr uint32_t kBinary = 1;
constexpr uint32_t kBytes = 2;
constexpr size_t kHeaderBytes = kMagic.size() + 3 * sizeof(uint32_t);

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

template <typename Descriptor>
constexpr uint32_t kKind = std::is_same_v<Descriptor, BinaryDescriptor> ? kBinary : kBytes;

void CheckKind(uint32_t kind, uint32_t expected) {
  Require(kind == kBinary || kind == kBytes, "unknown version");
  Require(kind == expected, kind == kBytes ? "of 128-byte descriptors" : "of 32-byte descriptors");
}

}  // namespace

template <typename Descriptor>
std::vector<uint8_t> BasicVocabulary<Descriptor>::ToBytes() const {
  std::vector<uint8_t> bytes(kMagic.begin(), kMagic.end());
  const auto append = [&bytes](uint32_t value) {
    const std::array<uint8_t, 4> encoded = LittleEndian(value);
    bytes.insert(bytes.end(), encoded.begin(), encoded.end());
  };
  append(kKind<Descriptor>);
  append(static_cast<uint32_t>(nodes_.size()));
  append(num_words());
  const auto* centroids = reinterpret_cast<const uint8_t*>(centroids_.data());
  bytes.insert(bytes.end(), centroids, centroids + sizeof(Descriptor) * centroids_.size());
  for (const VocabularyNode& node : nodes_) {
    bytes.push_back(static_cast<uint8_t>(node.num_children));
  }
  for (const float weight : idf_) append(BitsOf(weight));
  return bytes;
}

template <typename Descriptor>
BasicVocabulary<Descriptor> BasicVocabulary<Descriptor>::FromBytes(const uint8_t* bytes,
                                                                   size_t num_bytes) {
  Require(num_bytes >= kHeaderBytes, "too short");
  Require(std::equal(kMagic.begin(), kMagic.end(), bytes), "not a vocabulary");
  const uint8_t* cursor = bytes + kMagic.size();
  CheckKind(FromLittleEndian(cursor), kKind<Descriptor>);
  const size_t num_nodes = FromLittleEndian(cursor + 4);
  const size_t num_words = FromLittleEndian(cursor + 8);
  // Both counts are 32 bits wide, so the expected length cannot overflow.
  Require(
      num_bytes == kHeaderBytes + (sizeof(Descriptor) + 1) * num_nodes + sizeof(float) * num_words,
      "length differs from the header's counts");

  cursor = bytes + kHeaderBytes;
  std::vector<Descriptor> centroids = DescriptorsFromBytes<Descriptor>(cursor, num_nodes);
  cursor += sizeof(Descriptor) * num_nodes;
  const std::vector<uint8_t> num_children(cursor, cursor + num_nodes);
  cursor += num_nodes;
  std::vector<float> idf(num_words);
  for (size_t i = 0; i < num_words; ++i) idf[i] = FloatOf(FromLittleEndian(cursor + 4 * i));
  return BasicVocabulary(std::move(centroids), num_children, std::move(idf));
}

template std::vector<uint8_t> BasicVocabulary<BinaryDescriptor>::ToBytes() const;
template std::vector<uint8_t> BasicVocabulary<ByteDescriptor>::ToBytes() const;
template Vocabulary Vocabulary::FromBytes(const uint8_t* bytes, size_t num_bytes);
template ByteVocabulary ByteVocabulary::FromBytes(const uint8_t* bytes, size_t num_bytes);

}  // namespace covinz
