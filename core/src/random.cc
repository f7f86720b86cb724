#include "covinz/random.h"

#include <algorithm>

namespace covinz {

uint64_t DeriveSeed(uint64_t seed, uint64_t stream) {
  uint64_t z = seed + (stream + 1) * 0x9e3779b97f4a7c15ULL;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
  return z ^ (z >> 31);
}

int Random::Below(int n) {
  const uint64_t range = static_cast<uint64_t>(n);
  // Values of the incomplete last block would favour small results.
  const uint64_t limit = range * (UINT64_MAX / range);
  uint64_t value = engine_();
  while (value >= limit) value = engine_();
  return static_cast<int>(value % range);
}

void Random::DrawDistinct(int begin, int end, int num_draws, std::vector<int>& sample) {
  // Samples are far smaller than their population, so drawing again is rare.
  for (int i = 0; i < num_draws; ++i) {
    int value = begin + Below(end - begin);
    while (std::find(sample.begin(), sample.end(), value) != sample.end()) {
      value = begin + Below(end - begin);
    }
    sample.push_back(value);
  }
}

}  // namespace covinz
