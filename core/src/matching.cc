// Exact brute-force matching: every distance once, both directions from the same distances.
#include "covinz/matching.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>

#include "covinz/binary_descriptor.h"

namespace covinz {
namespace {

constexpr size_t kWordBytes = sizeof(uint64_t);

// Word w of descriptor i is words[w * num_descriptors + i], so that the distances to neighbouring
// descriptors are counted side by side; the last word is padded with zeros.
std::vector<uint64_t> AsWords(const Descriptors& descriptors) {
  const size_t num_descriptors = static_cast<size_t>(descriptors.rows());
  const size_t num_bytes = static_cast<size_t>(descriptors.cols());
  const size_t num_words = (num_bytes + kWordBytes - 1) / kWordBytes;
  std::vector<uint64_t> words(num_words * num_descriptors, 0);
  for (size_t i = 0; i < num_descriptors; ++i) {
    for (size_t w = 0; w < num_words; ++w) {
      std::memcpy(&words[w * num_descriptors + i],
                  descriptors.data() + i * num_bytes + w * kWordBytes,
                  std::min(kWordBytes, num_bytes - w * kWordBytes));
    }
  }
  return words;
}

COVINZ_POPCNT_CLONES
void AddDifferingBits(uint64_t query_word,
                      const uint64_t* cand_words,
                      size_t num_cand,
                      uint64_t* distances) {
  for (size_t i = 0; i < num_cand; ++i) {
    distances[i] += static_cast<uint64_t>(__builtin_popcountll(query_word ^ cand_words[i]));
  }
}

class HammingDistances {
 public:
  HammingDistances(const Descriptors& query, const Descriptors& cand)
      : num_query_(static_cast<size_t>(query.rows())),
        query_(AsWords(query)),
        cand_(AsWords(cand)) {}

  // From one query descriptor to every candidate.
  void operator()(size_t query, std::vector<uint64_t>& distances) const {
    std::fill(distances.begin(), distances.end(), 0);
    for (size_t w = 0; w * num_query_ < query_.size(); ++w) {
      AddDifferingBits(query_[w * num_query_ + query], &cand_[w * distances.size()],
                       distances.size(), distances.data());
    }
  }

  static double Distance(uint64_t num_bits) { return static_cast<double>(num_bits); }

 private:
  size_t num_query_;
  std::vector<uint64_t> query_;
  std::vector<uint64_t> cand_;
};

class EuclideanDistances {
 public:
  EuclideanDistances(const Descriptors& query, const Descriptors& cand)
      : query_(query), cand_(cand) {}

  void operator()(size_t query, std::vector<uint64_t>& distances) const {
    const size_t num_bytes = static_cast<size_t>(query_.cols());
    const uint8_t* a = query_.data() + query * num_bytes;
    for (size_t i = 0; i < distances.size(); ++i) {
      const uint8_t* b = cand_.data() + i * num_bytes;
      uint64_t sum = 0;
      for (size_t k = 0; k < num_bytes; ++k) {
        const int difference = int{a[k]} - int{b[k]};
        sum += static_cast<uint64_t>(difference * difference);
      }
      distances[i] = sum;
    }
  }

  static double Distance(uint64_t squared) { return std::sqrt(static_cast<double>(squared)); }

 private:
  const Descriptors& query_;
  const Descriptors& cand_;
};

// The nearest and the second nearest candidate, the first one of equals.
struct TwoNearest {
  static constexpr uint64_t kNone = std::numeric_limits<uint64_t>::max();
  size_t cand = 0;
  uint64_t nearest = kNone;
  uint64_t second = kNone;
};

TwoNearest FindTwoNearest(const std::vector<uint64_t>& distances) {
  TwoNearest found;
  for (size_t i = 0; i < distances.size(); ++i) {
    if (distances[i] >= found.second) continue;
    if (distances[i] < found.nearest) {
      found.second = found.nearest;
      found.nearest = distances[i];
      found.cand = i;
    } else {
      found.second = distances[i];
    }
  }
  return found;
}

template <typename Distances>
bool IsDistinct(const TwoNearest& found, const MatchingOptions& options) {
  if (!(Distances::Distance(found.nearest) <= options.max_distance)) return false;
  if (options.max_ratio >= 1.0) return true;
  return found.second != TwoNearest::kNone &&
         Distances::Distance(found.nearest) < options.max_ratio * Distances::Distance(found.second);
}

template <typename Distances>
std::vector<Match> MatchBy(const Descriptors& query,
                           const Descriptors& cand,
                           const MatchingOptions& options) {
  const Distances distances_of(query, cand);
  const size_t num_cand = static_cast<size_t>(cand.rows());
  std::vector<uint64_t> distances(num_cand);
  // Of each candidate, the distance to its nearest query descriptor and the row of that.
  std::vector<uint64_t> least(num_cand, TwoNearest::kNone);
  std::vector<int> nearest_query(num_cand, -1);
  std::vector<Match> matches;
  for (int q = 0; q < static_cast<int>(query.rows()); ++q) {
    distances_of(static_cast<size_t>(q), distances);
    for (size_t i = 0; i < num_cand; ++i) {
      if (distances[i] >= least[i]) continue;
      least[i] = distances[i];
      nearest_query[i] = q;
    }
    const TwoNearest found = FindTwoNearest(distances);
    if (IsDistinct<Distances>(found, options)) matches.push_back({q, static_cast<int>(found.cand)});
  }
  if (!options.mutual) return matches;
  std::vector<Match> mutual;
  for (const Match& match : matches) {
    if (nearest_query[static_cast<size_t>(match.cand)] == match.query) mutual.push_back(match);
  }
  return mutual;
}

}  // namespace

void MatchingOptions::Check() const {
  if (!(max_ratio > 0.0 && max_ratio <= 1.0)) {
    throw std::invalid_argument("MatchingOptions.max_ratio must be in (0, 1]");
  }
  if (!(max_distance >= 0.0)) {
    throw std::invalid_argument("MatchingOptions.max_distance must not be negative");
  }
}

std::vector<Match> MatchDescriptors(const Descriptors& query,
                                    const Descriptors& cand,
                                    const MatchingOptions& options) {
  options.Check();
  if (query.rows() == 0 || cand.rows() == 0) return {};
  if (query.cols() != cand.cols()) {
    throw std::invalid_argument("descriptors differ in length: " + std::to_string(query.cols()) +
                                " and " + std::to_string(cand.cols()) + " bytes");
  }
  return options.norm == DescriptorNorm::kHamming
             ? MatchBy<HammingDistances>(query, cand, options)
             : MatchBy<EuclideanDistances>(query, cand, options);
}

}  // namespace covinz
