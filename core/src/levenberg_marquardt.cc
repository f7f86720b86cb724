// Steps, their lengths and their damping.
#include "levenberg_marquardt.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace covinz {
namespace {

// Pose graphs start near enough for steps that are all but Gauss-Newton's.
constexpr double kInitialDamping = 1e-6;
constexpr double kLeastDamping = 1e-12;
// Bounds of the Hessian's diagonal, as a scale for the damping. [Ceres]
constexpr double kLeastDiagonal = 1e-6;
constexpr double kGreatestDiagonal = 1e32;
// A step must lower the cost by so much of what the model promises. [Ceres]
constexpr double kLeastGain = 1e-3;
// At most so many lengths are tried along a step.
constexpr int kMaxLengths = 4;

Eigen::VectorXd Diagonal(const SymmetricBlockMatrix& matrix) {
  Eigen::VectorXd diagonal(static_cast<Eigen::Index>(6 * matrix.diagonal.size()));
  for (size_t i = 0; i < matrix.diagonal.size(); ++i) {
    diagonal.segment<6>(static_cast<Eigen::Index>(6 * i)) = matrix.diagonal[i].diagonal();
  }
  return diagonal;
}

}  // namespace

LevenbergMarquardt::LevenbergMarquardt(const PoseGraphObjective& objective,
                                       const PoseGraphOptions& options)
    : objective_(objective),
      options_(options),
      model_(objective.EmptyModel()),
      cholesky_(model_.hessian) {}

void LevenbergMarquardt::Minimize(double cauchy_scale,
                                  double function_tolerance,
                                  PoseEstimate* estimate) {
  cauchy_scale_ = cauchy_scale;
  damping_ = kInitialDamping;
  growth_ = 2.0;
  estimate->cost = objective_.Cost(estimate->poses, cauchy_scale);
  Relinearize(Curvature::kReweighted, *estimate);
  estimate->converged = GradientVanishes();
  for (int i = 0; i < options_.max_num_iterations && !estimate->converged; ++i) {
    ++estimate->num_iterations;
    if (!ComputeDirection()) {
      Retreat(*estimate);
      continue;
    }
    // Half of the decrease that the slope promises is the other half's price in curvature.
    const double promised = -0.5 * model_.gradient.dot(direction_);
    Trial trial = SearchAlongDirection(*estimate);
    const double change = estimate->cost - trial.cost;
    if (change > kLeastGain * promised) {
      estimate->converged =
          change <= function_tolerance * estimate->cost || DirectionVanishes(estimate->poses);
      estimate->poses = std::move(trial.poses);
      estimate->cost = trial.cost;
      if (estimate->converged) break;
      Advance(change / promised, change, *estimate);
      estimate->converged = GradientVanishes();
    } else {
      // Below the rounding of the cost nothing can be told from it.
      estimate->converged =
          DirectionVanishes(estimate->poses) || promised <= 1e-15 * estimate->cost;
      Retreat(*estimate);
    }
  }
}

bool LevenbergMarquardt::GradientVanishes() const {
  return model_.gradient.size() == 0 ||
         model_.gradient.cwiseAbs().maxCoeff() <= options_.gradient_tolerance;
}

// As Ceres has it: the state's norm is that of quaternions and positions.
bool LevenbergMarquardt::DirectionVanishes(const std::vector<Pose>& poses) const {
  double squared_norm = 0.0;
  for (const Pose& pose : poses) squared_norm += 1.0 + pose.p.squaredNorm();
  const double tolerance = options_.parameter_tolerance;
  return direction_.norm() <= tolerance * (std::sqrt(squared_norm) + tolerance);
}

// False when the damped Hessian is not positive definite or the direction no descent.
bool LevenbergMarquardt::ComputeDirection() {
  const Eigen::VectorXd scale =
      Diagonal(model_.hessian).cwiseMax(kLeastDiagonal).cwiseMin(kGreatestDiagonal);
  if (!cholesky_.Factorize(model_.hessian, damping_ * scale)) return false;
  direction_ = -cholesky_.Solve(model_.gradient);
  return direction_.allFinite() && model_.gradient.dot(direction_) < 0.0;
}

LevenbergMarquardt::Trial LevenbergMarquardt::TryLength(double length,
                                                        const PoseEstimate& estimate) const {
  Trial trial;
  trial.length = length;
  trial.poses = objective_.Moved(estimate.poses, length * direction_);
  trial.cost = objective_.Cost(trial.poses, cauchy_scale_);
  return trial;
}

// The full step, and then the minima of parabolas through the slope and the best length so far.
LevenbergMarquardt::Trial LevenbergMarquardt::SearchAlongDirection(
    const PoseEstimate& estimate) const {
  const double slope = model_.gradient.dot(direction_);
  Trial best = TryLength(1.0, estimate);
  for (int i = 1; i < kMaxLengths; ++i) {
    const double rise = best.cost - estimate.cost - slope * best.length;
    const double vertex = -0.5 * slope * best.length * best.length / rise;
    const double length = rise > 0.0 ? std::min(vertex, 4.0 * best.length) : 4.0 * best.length;
    const bool better = length > 1.2 * best.length || best.cost > estimate.cost;
    if (!better || !std::isfinite(length)) break;
    Trial trial = TryLength(length, estimate);
    if (!(trial.cost < best.cost)) break;
    best = std::move(trial);
  }
  return best;
}

void LevenbergMarquardt::Relinearize(Curvature curvature, const PoseEstimate& estimate) {
  curvature_ = curvature;
  objective_.Linearize(estimate.poses, cauchy_scale_, curvature, &model_);
}

// After a step with `gain` times the promised decrease. The damping follows Nielsen, "Damping
// parameter in Marquardt's method", 1999.
void LevenbergMarquardt::Advance(double gain, double change, const PoseEstimate& estimate) {
  damping_ *= std::max(0.1, 1.0 - std::pow(2.0 * gain - 1.0, 3));
  damping_ = std::max(damping_, kLeastDamping);
  growth_ = 2.0;
  const bool near = change < 0.2 * (estimate.cost + change);
  if (gain < 0.25) {
    Relinearize(Curvature::kReweighted, estimate);
  } else {
    Relinearize(gain > 0.75 && near ? Curvature::kConvex : curvature_, estimate);
  }
}

// After a step that failed: first a safer Hessian, then more damping.
void LevenbergMarquardt::Retreat(const PoseEstimate& estimate) {
  if (curvature_ != Curvature::kReweighted) {
    Relinearize(Curvature::kReweighted, estimate);
    return;
  }
  damping_ = std::max(damping_, kInitialDamping) * growth_;
  growth_ *= 2.0;
}

}  // namespace covinz
