// The relative pose residual of equation (1), with its Jacobians.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "covinz/se3.h"

namespace covinz {

struct RelativePoseResidual {
  Vector6d error;   // [rotation (rad), translation (m)] in the frame of the measured `to` body
  Matrix6d J_from;  // d error / d perturbation of T_map_from (tangent of se3.h)
  Matrix6d J_to;    // d error / d perturbation of T_map_to
};

// e_ij = Log(T_from_to^-1 * T_map_from^-1 * T_map_to): how far the estimated relative pose is
// from the measured one, in the tangent in which the measurement's covariance is given.
//
// Source: COVINS-G, III-C, "the standard relative pose residual".
RelativePoseResidual EvaluateRelativePose(const Eigen::Quaterniond& q_map_from,
                                          const Eigen::Vector3d& p_map_from,
                                          const Eigen::Quaterniond& q_map_to,
                                          const Eigen::Vector3d& p_map_to,
                                          const Eigen::Isometry3d& T_from_to);

}  // namespace covinz
