#include "covinz/rig_scale.h"

#include <algorithm>
#include <stdexcept>

namespace covinz {

void RigScaleOptions::Check() const {
  if (!(max_common_centre_ratio > 0.0 && max_common_centre_ratio <= 1.0)) {
    throw std::invalid_argument("RigScaleOptions.max_common_centre_ratio must be in (0, 1]");
  }
  if (!(max_error_px > 0.0)) {
    throw std::invalid_argument("RigScaleOptions.max_error_px must be positive");
  }
  if (max_num_iterations < 1) {
    throw std::invalid_argument("RigScaleOptions.max_num_iterations must be at least 1");
  }
}

double CommonCentreRatio(const RigPairs& rigs,
                         const RigRelativePose& estimate,
                         const RigScaleOptions& options,
                         uint64_t seed) {
  options.Check();
  BearingPairs pooled;
  for (size_t p = 0; p < rigs.pairs.size(); ++p) {
    const BearingPairs& pairs = rigs.pairs[p];
    // Pixels of different cameras are counted alike; the coarsest sets the angle.
    const double focal_px = std::min(pairs.query_focal_px, pairs.cand_focal_px);
    pooled.query_focal_px = p == 0 ? focal_px : std::min(pooled.query_focal_px, focal_px);
    const Eigen::Matrix3d R_query_cam =
        rigs.T_query_cam[static_cast<size_t>(pairs.query_cam)].linear();
    const Eigen::Matrix3d R_cand_cam =
        rigs.T_cand_cam[static_cast<size_t>(pairs.cand_cam)].linear();
    for (const int i : estimate.inliers[p]) {
      pooled.query.push_back((R_query_cam * pairs.query[static_cast<size_t>(i)]).normalized());
      pooled.cand.push_back((R_cand_cam * pairs.cand[static_cast<size_t>(i)]).normalized());
    }
  }
  if (pooled.size() == 0) return 1.0;
  pooled.cand_focal_px = pooled.query_focal_px;
  RelativePoseOptions ransac;
  ransac.max_error_px = options.max_error_px;
  ransac.max_num_iterations = options.max_num_iterations;
  const std::optional<RelativePose> central = EstimateRelativePose(pooled, ransac, seed);
  if (!central) return 0.0;
  return static_cast<double>(central->inliers.size()) / static_cast<double>(pooled.size());
}

}  // namespace covinz
