// SHA-256 against the examples of FIPS 180-4, with every length around a block's end.
#include "covinz/sha256.h"

#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace covinz {
namespace {

std::string HexOf(const std::string& text) {
  return ToHex(Sha256(reinterpret_cast<const uint8_t*>(text.data()), text.size()));
}

TEST(Sha256, KnownDigests) {
  EXPECT_EQ(HexOf(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(HexOf("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(HexOf("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq"),
            "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
  EXPECT_EQ(HexOf(std::string(1000000, 'a')),
            "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TEST(Sha256, EveryTailLengthCounts) {
  std::set<std::string> digests;
  for (size_t length = 0; length < 130; ++length) digests.insert(HexOf(std::string(length, 'x')));
  EXPECT_EQ(digests.size(), 130u);
}

}  // namespace
}  // namespace covinz
