// SHA-256 (FIPS 180-4): checksum and identity of a vocabulary.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>

namespace covinz {

using Sha256Digest = std::array<uint8_t, 32>;

Sha256Digest Sha256(const uint8_t* bytes, size_t num_bytes);

// Lower-case hexadecimal digits, 64 of them.
std::string ToHex(const Sha256Digest& digest);

}  // namespace covinz
