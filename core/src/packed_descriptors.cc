// Interleaves the descriptors of an image for the matching kernels.
#include <algorithm>
#include <cstring>
#include <numeric>
#include <stdexcept>
#include <string>

#include "covinz/rig_matching.h"

namespace covinz {

PackedDescriptors::PackedDescriptors(const Descriptors& descriptors)
    : rows_(static_cast<size_t>(descriptors.rows())) {
  std::iota(rows_.begin(), rows_.end(), 0);
  Pack(descriptors);
}

PackedDescriptors::PackedDescriptors(const Descriptors& descriptors, const Points3& bearings) {
  if (bearings.rows() != descriptors.rows()) {
    throw std::invalid_argument("PackedDescriptors: " + std::to_string(bearings.rows()) +
                                " bearings but " + std::to_string(descriptors.rows()) +
                                " descriptors");
  }
  for (Eigen::Index i = 0; i < bearings.rows(); ++i) {
    if (bearings.row(i).allFinite()) rows_.push_back(static_cast<int>(i));
  }
  Pack(descriptors);
}

void PackedDescriptors::Pack(const Descriptors& descriptors) {
  num_bytes_ = static_cast<size_t>(descriptors.cols());
  if (num_bytes_ > kMaxBytes) {
    throw std::invalid_argument("PackedDescriptors: descriptors of " + std::to_string(num_bytes_) +
                                " bytes, at most " + std::to_string(kMaxBytes) + " are possible");
  }
  constexpr size_t kGroupBytes = sizeof(uint32_t);
  num_groups_ = (num_bytes_ + kStepBytes - 1) / kStepBytes * (kStepBytes / kGroupBytes);
  const size_t num_padded = (rows_.size() + kLanes - 1) / kLanes * kLanes;
  const size_t num_words = num_groups_ / 2;
  groups_.assign(num_padded * num_groups_, 0);
  words_.assign(num_padded * num_words, 0);
  sums_.assign(num_padded, 0);
  squared_norms_.assign(num_padded, 0);
  if (num_bytes_ == 0) return;
  for (size_t i = 0; i < rows_.size(); ++i) {
    const uint8_t* bytes = descriptors.data() + static_cast<size_t>(rows_[i]) * num_bytes_;
    uint64_t* words = words_.data() + i * num_words;
    std::memcpy(words, bytes, num_bytes_);
    uint32_t* groups = groups_.data() + i / kLanes * kLanes * num_groups_ + i % kLanes;
    for (size_t g = 0; g < num_groups_; ++g) {
      std::memcpy(groups + g * kLanes, reinterpret_cast<const uint8_t*>(words) + g * kGroupBytes,
                  kGroupBytes);
    }
    uint32_t sum = 0;
    uint32_t squared_norm = 0;
    for (size_t k = 0; k < num_bytes_; ++k) {
      sum += bytes[k];
      squared_norm += uint32_t{bytes[k]} * bytes[k];
    }
    sums_[i] = sum;
    squared_norms_[i] = squared_norm;
  }
}

}  // namespace covinz
