// Reproducible random draws: the same seed gives the same numbers with every standard library.
#pragma once

#include <cstdint>
#include <random>
#include <vector>

namespace covinz {

// Seed of an independent stream: one user seed serves every stage and camera pair.
// Source: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014 (splitmix64).
uint64_t DeriveSeed(uint64_t seed, uint64_t stream);

class Random {
 public:
  explicit Random(uint64_t seed) : engine_(seed) {}

  // Uniform in [0, n), unbiased; n > 0. (The standard fixes the engine but not its distributions.)
  int Below(int n);

  // Adds num_draws values of [begin, end) to the sample, none of them already in it; at least
  // that many must be left.
  void DrawDistinct(int begin, int end, int num_draws, std::vector<int>& sample);

 private:
  std::mt19937_64 engine_;
};

}  // namespace covinz
