// Errors of stamps along the twists of cameras.
#include "covinz/rig_exposure.h"

#include <cmath>
#include <stdexcept>

#include "covinz/rig_refinement.h"

namespace covinz {
namespace {

// In the camera's frame.
Matrix6d StampCovariance(const CameraExposure& exposure) {
  const double half = 0.5 * exposure.stamp_sigma_s * exposure.stamp_sigma_s;
  return half * (exposure.twist_before * exposure.twist_before.transpose() +
                 exposure.twist_after * exposure.twist_after.transpose());
}

Matrix6d Moved(const Eigen::Isometry3d& T, const Matrix6d& covariance) {
  const Matrix6d Ad = AdjointSE3(T);
  const Matrix6d moved = Ad * covariance * Ad.transpose();
  return 0.5 * (moved + moved.transpose());
}

}  // namespace

void CameraExposure::Check() const {
  if (!(twist_before.allFinite() && twist_after.allFinite() && std::isfinite(stamp_sigma_s) &&
        stamp_sigma_s >= 0.0 && std::isfinite(row_s) && row_s >= 0.0)) {
    throw std::invalid_argument("CameraExposure: twists must be finite, times at least 0");
  }
}

std::vector<RigMotion> MotionsBetweenImages(const RefinedRig& rig) {
  std::vector<RigMotion> motions = rig.motions;
  if (rig.exposures.empty()) return motions;
  for (RigMotion& motion : motions) {
    const size_t from = static_cast<size_t>(motion.from);
    const size_t to = static_cast<size_t>(motion.to);
    motion.covariance += StampCovariance(rig.exposures[to]) +
                         Moved(rig.T_rig_cam[to].inverse() * rig.T_rig_cam[from],
                               StampCovariance(rig.exposures[from]));
  }
  return motions;
}

Matrix6d StampCovariance(const RefinedRig& cand,
                         const RefinedRig& query,
                         const Eigen::Isometry3d& T_cand_query) {
  Matrix6d covariance = Matrix6d::Zero();
  // The reference cameras are fixed to their bodies.
  if (!query.exposures.empty()) {
    covariance += Moved(query.T_rig_cam[0], StampCovariance(query.exposures[0]));
  }
  if (!cand.exposures.empty()) {
    covariance +=
        Moved(T_cand_query.inverse() * cand.T_rig_cam[0], StampCovariance(cand.exposures[0]));
  }
  return covariance;
}

double RowVariance_rad2(const CameraExposure& exposure) {
  return 0.5 * exposure.stamp_sigma_s * exposure.stamp_sigma_s *
         (exposure.twist_before.head<3>().squaredNorm() +
          exposure.twist_after.head<3>().squaredNorm());
}

}  // namespace covinz
