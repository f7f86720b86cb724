#include "covinz/relative_pose.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include <Eigen/SVD>
#include <opengv/relative_pose/CentralRelativeAdapter.hpp>
#include <opengv/relative_pose/methods.hpp>

#include "covinz/random.h"

namespace covinz {
namespace {

constexpr int kSampleSize = 5;

int CountSampsonInliers(const Eigen::Matrix3d& E, const BearingPairs& pairs, double max_error_px) {
  int count = 0;
  for (size_t i = 0; i < pairs.size(); ++i) {
    if (SquaredSampsonError_px2(E, pairs, i) <= max_error_px * max_error_px) ++count;
  }
  return count;
}

// Stewenius' solver as in the public code: OpenGV's Nister solver misses the true root of every
// 25th noise-free sample.
std::vector<Eigen::Matrix3d> SolveFivePoint(
    const opengv::relative_pose::CentralRelativeAdapter& adapter, const std::vector<int>& sample) {
  std::vector<Eigen::Matrix3d> essentials;
  for (const Eigen::Matrix3cd& E : opengv::relative_pose::fivept_stewenius(adapter, sample)) {
    if (E.allFinite() && E.imag().norm() < 1e-6 * E.norm()) essentials.emplace_back(E.real());
  }
  return essentials;
}

// The four poses of an essential matrix. Source: Hartley, Zisserman, Multiple View Geometry, 9.6.2.
std::array<Eigen::Isometry3d, 4> Decompose(const Eigen::Matrix3d& E) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(E, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d U = svd.matrixU();
  Eigen::Matrix3d V = svd.matrixV();
  if (U.determinant() < 0.0) U = -U;
  if (V.determinant() < 0.0) V = -V;
  Eigen::Matrix3d W;
  W << 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0;
  std::array<Eigen::Isometry3d, 4> poses;
  for (size_t i = 0; i < poses.size(); ++i) {
    const Eigen::Matrix3d R =
        i < 2 ? Eigen::Matrix3d(U * W * V.transpose()) : U * W.transpose() * V.transpose();
    poses[i] = Eigen::Isometry3d::Identity();
    poses[i].linear() = R;
    poses[i].translation() = (i % 2 == 0 ? 1.0 : -1.0) * U.col(2);
  }
  return poses;
}

// Of the poses of E, the one with the most inliers, if it has more than the best so far.
void KeepBetterPose(const Eigen::Matrix3d& E,
                    const BearingPairs& pairs,
                    double max_error_px,
                    RelativePose& best) {
  for (const Eigen::Isometry3d& T_cand_query : Decompose(E)) {
    std::vector<int> inliers = FindInliers(T_cand_query, pairs, max_error_px);
    if (inliers.size() > best.inliers.size()) {
      best.T_cand_query = T_cand_query;
      best.inliers = std::move(inliers);
    }
  }
}

}  // namespace

void RelativePoseOptions::Check() const {
  if (!(max_error_px > 0.0)) {
    throw std::invalid_argument("RelativePoseOptions.max_error_px must be positive");
  }
  if (!(confidence > 0.0 && confidence < 1.0)) {
    throw std::invalid_argument("RelativePoseOptions.confidence must be in (0, 1)");
  }
  if (max_num_iterations < 1) {
    throw std::invalid_argument("RelativePoseOptions.max_num_iterations must be at least 1");
  }
}

int NumRansacIterations(double good_sample, double confidence, int max_num_iterations) {
  if (good_sample >= 1.0) return 1;
  const double num_iterations = std::log1p(-confidence) / std::log1p(-good_sample);
  // Also for good_sample = 0, which gives infinity.
  if (!(num_iterations < max_num_iterations)) return max_num_iterations;
  return std::max(1, static_cast<int>(std::ceil(num_iterations)));
}

std::optional<RelativePose> EstimateRelativePose(const BearingPairs& pairs,
                                                 const RelativePoseOptions& options,
                                                 uint64_t seed) {
  options.Check();
  pairs.Check();
  const int num_pairs = static_cast<int>(pairs.size());
  if (num_pairs < kSampleSize) return std::nullopt;
  const opengv::bearingVectors_t cand(pairs.cand.begin(), pairs.cand.end());
  const opengv::bearingVectors_t query(pairs.query.begin(), pairs.query.end());
  const opengv::relative_pose::CentralRelativeAdapter adapter(cand, query);

  Random random(seed);
  RelativePose best;
  best.num_iterations = 0;
  int num_iterations = options.max_num_iterations;
  while (best.num_iterations < num_iterations) {
    ++best.num_iterations;
    std::vector<int> sample;
    random.DrawDistinct(0, num_pairs, kSampleSize, sample);
    for (const Eigen::Matrix3d& E : SolveFivePoint(adapter, sample)) {
      // Cheap first: depths can only lower the count.
      const int upper_bound = CountSampsonInliers(E, pairs, options.max_error_px);
      if (upper_bound <= static_cast<int>(best.inliers.size())) continue;
      KeepBetterPose(E, pairs, options.max_error_px, best);
    }
    const double inlier_ratio = static_cast<double>(best.inliers.size()) / num_pairs;
    num_iterations = NumRansacIterations(std::pow(inlier_ratio, kSampleSize), options.confidence,
                                         options.max_num_iterations);
  }
  if (best.inliers.size() < kSampleSize) return std::nullopt;
  return best;
}

}  // namespace covinz
