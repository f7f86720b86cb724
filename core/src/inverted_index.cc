// Verified votes.
#include "covinz/inverted_index.h"

#include <cmath>
#include <stdexcept>
#include <string>

namespace covinz {
namespace {

// How many words before its turn what stands under a word is asked for, and how much of it.
constexpr size_t kAhead = 8;
constexpr int kLinesAhead = 4;

void CheckLengths(size_t num_words, size_t num_codes) {
  if (num_words != num_codes) {
    throw std::invalid_argument("Inverted index: the numbers of words and codes differ");
  }
}

template <size_t kWords>
using Codes = std::vector<std::array<uint64_t, kWords>>;

// Writes the keyframes that hold a code near the query, each once, and returns how many; `hits` has
// room for all. `keyframes` ascends, so repeats are neighbours.
template <size_t kWords>
inline __attribute__((always_inline)) size_t ScanPostings(const std::array<uint64_t, kWords>& query,
                                                          const Codes<kWords>& codes,
                                                          const std::vector<uint32_t>& keyframes,
                                                          int max_hamming,
                                                          uint32_t* hits) {
  size_t num_hits = 0;
  for (size_t i = 0; i < codes.size(); ++i) {
    if (HammingDistance(query, codes[i]) > max_hamming) continue;
    if (num_hits == 0 || hits[num_hits - 1] != keyframes[i]) hits[num_hits++] = keyframes[i];
  }
  return num_hits;
}

// What a look at postings needs first; what follows the processor fetches by itself.
template <typename Postings>
inline void Prefetch(const Postings* postings) {
  if (postings == nullptr) return;
  const char* codes = reinterpret_cast<const char*>(postings->codes.data());
  for (int line = 0; line < kLinesAhead; ++line) __builtin_prefetch(codes + 64 * line);
  __builtin_prefetch(postings->keyframes.data());
}

// Versions of a function template cannot be chosen at run time, those of functions can.
COVINZ_POPCNT_CLONES
size_t FindHits(const std::array<uint64_t, 2>& query,
                const Codes<2>& codes,
                const std::vector<uint32_t>& keyframes,
                int max_hamming,
                uint32_t* hits) {
  return ScanPostings<2>(query, codes, keyframes, max_hamming, hits);
}

COVINZ_POPCNT_CLONES
size_t FindHits(const std::array<uint64_t, 4>& query,
                const Codes<4>& codes,
                const std::vector<uint32_t>& keyframes,
                int max_hamming,
                uint32_t* hits) {
  return ScanPostings<4>(query, codes, keyframes, max_hamming, hits);
}

}  // namespace

template <size_t kWords>
BasicInvertedIndex<kWords>::BasicInvertedIndex(int max_hamming) : max_hamming_(max_hamming) {
  const int num_bits = 64 * static_cast<int>(kWords);
  if (max_hamming < 0 || max_hamming > num_bits) {
    throw std::invalid_argument("Inverted index: max_hamming must be 0 to " +
                                std::to_string(num_bits));
  }
}

template <size_t kWords>
uint32_t BasicInvertedIndex<kWords>::Add(const std::vector<uint32_t>& words,
                                         const std::vector<Code>& codes) {
  CheckLengths(words.size(), codes.size());
  for (size_t i = 0; i < words.size(); ++i) {
    Postings& postings = postings_[words[i]];
    postings.keyframes.push_back(size_);
    postings.codes.push_back(codes[i]);
  }
  return size_++;
}

template <size_t kWords>
std::vector<float> BasicInvertedIndex<kWords>::Votes(const std::vector<uint32_t>& words,
                                                     const std::vector<Code>& codes) const {
  CheckLengths(words.size(), codes.size());
  // Where to look for each code, all of it before the first look: they are all over the memory,
  // which can be asked for several at once.
  std::vector<const Postings*> found(words.size(), nullptr);
  for (size_t i = 0; i < words.size(); ++i) {
    const auto at = postings_.find(words[i]);
    if (at != postings_.end()) found[i] = &at->second;
  }
  std::vector<double> votes(size_, 0.0);
  std::vector<uint32_t> hits;
  for (size_t i = 0; i < words.size(); ++i) {
    if (i + kAhead < words.size()) Prefetch(found[i + kAhead]);
    if (found[i] == nullptr) continue;
    const Postings& postings = *found[i];
    if (hits.size() < postings.keyframes.size()) hits.resize(postings.keyframes.size());
    const size_t num_hits =
        FindHits(codes[i], postings.codes, postings.keyframes, max_hamming_, hits.data());
    if (num_hits == 0) continue;
    const double weight = std::log(static_cast<double>(size_) / static_cast<double>(num_hits));
    for (size_t k = 0; k < num_hits; ++k) votes[hits[k]] += weight;
  }
  return std::vector<float>(votes.begin(), votes.end());
}

template class BasicInvertedIndex<2>;
template class BasicInvertedIndex<4>;

}  // namespace covinz
