#include "covinz/epipolar.h"

#include <cmath>
#include <stdexcept>

#include "covinz/se3.h"

namespace covinz {

void BearingPairs::Check() const {
  if (query.size() != cand.size()) {
    throw std::invalid_argument("BearingPairs: one query bearing for each candidate bearing");
  }
  if (!(query_focal_px > 0.0 && cand_focal_px > 0.0)) {
    throw std::invalid_argument("BearingPairs: focal lengths must be positive");
  }
  for (size_t i = 0; i < query.size(); ++i) {
    if (!(std::abs(query[i].norm() - 1.0) < 1e-6 && std::abs(cand[i].norm() - 1.0) < 1e-6)) {
      throw std::invalid_argument("BearingPairs: bearings must be finite unit vectors");
    }
  }
}

Eigen::Matrix3d EssentialMatrix(const Eigen::Isometry3d& T_cand_query) {
  return Hat(T_cand_query.translation()) * T_cand_query.linear();
}

double SquaredSampsonError_px2(const Eigen::Matrix3d& E_cand_query,
                               const BearingPairs& pairs,
                               size_t i) {
  const Eigen::Vector3d normal_cand = E_cand_query * pairs.query[i];
  const Eigen::Vector3d normal_query = E_cand_query.transpose() * pairs.cand[i];
  const double error = pairs.cand[i].dot(normal_cand);
  // The part of a normal along its bearing equals the error and cannot be moved along.
  const double error2 = error * error;
  const double gradient2_cand = normal_cand.squaredNorm() - error2;
  const double gradient2_query = normal_query.squaredNorm() - error2;
  return error2 / (gradient2_query / (pairs.query_focal_px * pairs.query_focal_px) +
                   gradient2_cand / (pairs.cand_focal_px * pairs.cand_focal_px));
}

bool InFrontOfBoth(const Eigen::Isometry3d& T_cand_query,
                   const BearingPairs& pairs,
                   size_t i,
                   double max_error_px) {
  // Least squares of  depth_query * ray + t = depth_cand * bearing.
  const Eigen::Vector3d ray = T_cand_query.linear() * pairs.query[i];
  const Eigen::Vector3d& bearing = pairs.cand[i];
  const double cosine = ray.dot(bearing);
  const double sine2 = 1.0 - cosine * cosine;
  const double max_sine =
      max_error_px * std::hypot(1.0 / pairs.query_focal_px, 1.0 / pairs.cand_focal_px);
  if (sine2 < max_sine * max_sine) return cosine > 0.0;
  const double along_ray = ray.dot(T_cand_query.translation());
  const double along_bearing = bearing.dot(T_cand_query.translation());
  const double depth_query = cosine * along_bearing - along_ray;  // both times sine2 > 0
  const double depth_cand = along_bearing - cosine * along_ray;
  return depth_query > 0.0 && depth_cand > 0.0;
}

std::vector<int> FindInliers(const Eigen::Isometry3d& T_cand_query,
                             const BearingPairs& pairs,
                             double max_error_px) {
  const Eigen::Matrix3d E_cand_query = EssentialMatrix(T_cand_query);
  std::vector<int> inliers;
  for (size_t i = 0; i < pairs.size(); ++i) {
    if (SquaredSampsonError_px2(E_cand_query, pairs, i) <= max_error_px * max_error_px &&
        InFrontOfBoth(T_cand_query, pairs, i, max_error_px)) {
      inliers.push_back(static_cast<int>(i));
    }
  }
  return inliers;
}

}  // namespace covinz
