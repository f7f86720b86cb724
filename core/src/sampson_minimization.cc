#include "covinz/sampson_minimization.h"

#include <algorithm>

#include <Eigen/Cholesky>

namespace covinz {
namespace {

constexpr double kInitialDamping = 1e-4;
constexpr double kLeastDamping = 1e-9;
constexpr double kMostDamping = 1e4;
// A hundredth of the noise of a hypothesis, and above the rounding of the sums.
constexpr double kConvergedStep = 1e-4;
// Far from the optimum, and where the length of the loop is hardly observable, steps can be wild.
constexpr double kLongestTurn = 0.2;
constexpr double kLongestStep = 0.5;

Vector6d Step(const SampsonSystem& system, double damping) {
  Matrix6d damped = system.JtJ;
  // Marquardt's scaling: radians and metres, near and far scenes alike.
  damped.diagonal() *= 1.0 + damping;
  const Vector6d step = -damped.ldlt().solve(system.Jte);
  const double excess =
      std::max(step.head<3>().norm() / kLongestTurn, step.tail<3>().norm() / kLongestStep);
  return step / std::max(1.0, excess);
}

}  // namespace

Eigen::Isometry3d MinimizeSampson(const RigSampson& sampson,
                                  const Eigen::Isometry3d& T_cand_query,
                                  double max_error_px,
                                  int max_num_iterations,
                                  int stride) {
  Eigen::Isometry3d T = T_cand_query;
  SampsonSystem system = sampson.Linearize(T, max_error_px, stride);
  double damping = kInitialDamping;
  for (int i = 0; i < max_num_iterations && damping < kMostDamping; ++i) {
    const Vector6d step = Step(system, damping);
    if (!step.allFinite() || step.norm() < kConvergedStep) break;
    const Eigen::Isometry3d T_new = T * ExpSE3(step);
    const SampsonSystem system_new = sampson.Linearize(T_new, max_error_px, stride);
    if (system_new.cost < system.cost) {
      T = T_new;
      system = system_new;
      damping = std::max(0.1 * damping, kLeastDamping);
    } else {
      damping *= 10.0;
    }
  }
  return T;
}

}  // namespace covinz
