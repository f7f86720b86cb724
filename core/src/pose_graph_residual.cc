// Relative pose error of an edge and its analytic Jacobians.
#include "covinz/pose_graph_residual.h"

namespace covinz {

RelativePoseResidual EvaluateRelativePose(const Eigen::Quaterniond& q_map_from,
                                          const Eigen::Vector3d& p_map_from,
                                          const Eigen::Quaterniond& q_map_to,
                                          const Eigen::Vector3d& p_map_to,
                                          const Eigen::Isometry3d& T_from_to) {
  const Eigen::Matrix3d R_map_from_t = q_map_from.toRotationMatrix().transpose();
  const Eigen::Matrix3d R_meas_t = T_from_to.linear().transpose();
  const Eigen::Matrix3d R_est = R_map_from_t * q_map_to.toRotationMatrix();
  const Eigen::Vector3d p_est = R_map_from_t * (p_map_to - p_map_from);
  const Eigen::Matrix3d R_error = R_meas_t * R_est;

  RelativePoseResidual residual;
  residual.error << LogSO3(R_error), R_meas_t * (p_est - T_from_to.translation());

  // Perturbing `to` multiplies the error on the right: R_error Exp(d), p_error + R_error d.
  const Eigen::Matrix3d J_log = RightJacobianInverseSO3(residual.error.head<3>());
  residual.J_to.setZero();
  residual.J_to.topLeftCorner<3, 3>() = J_log;
  residual.J_to.bottomRightCorner<3, 3>() = R_error;

  // Perturbing `from` turns T_est from the left: Exp(-d) R_est = R_est Exp(-R_est^T d), and
  // Exp(-d) p_est = p_est + p_est x d.
  residual.J_from.setZero();
  residual.J_from.topLeftCorner<3, 3>() = -J_log * R_est.transpose();
  residual.J_from.bottomLeftCorner<3, 3>() = R_meas_t * Hat(p_est);
  residual.J_from.bottomRightCorner<3, 3>() = -R_meas_t;
  return residual;
}

}  // namespace covinz
