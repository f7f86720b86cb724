// Saddlepoint approximation of the tail of a sum of exponential variables.
#include "covinz/motion_tail.h"

#include <array>
#include <cmath>

namespace covinz {

double MotionCostTail(double cost, int num_motions, double dof) {
  const double n = num_motions;
  const double sum = cost / (dof + 6.0);
  const std::array<double, 3> rates = {0.5 * dof, 0.5 * dof + 1.0, 0.5 * dof + 2.0};
  double mean = 0.0;
  for (const double rate : rates) mean += n / rate;
  // Close to the mean the formula is 0 / 0; nothing is decided there.
  if (!(sum > 1.01 * mean)) return 1.0;
  // Where the derivative of the cumulant function K(t) = -n sum log(1 - t / rate) is the sum.
  double low = 0.0;
  double high = rates[0];
  for (int i = 0; i < 100; ++i) {
    const double t = 0.5 * (low + high);
    double derivative = 0.0;
    for (const double rate : rates) derivative += n / (rate - t);
    (derivative < sum ? low : high) = t;
  }
  const double t = low;
  double K = 0.0;
  double curvature = 0.0;
  for (const double rate : rates) {
    K -= n * std::log(1.0 - t / rate);
    curvature += n / ((rate - t) * (rate - t));
  }
  const double w = std::sqrt(2.0 * (t * sum - K));
  const double u = t * std::sqrt(curvature);
  const double density = std::exp(-0.5 * w * w) / std::sqrt(2.0 * M_PI);
  return 0.5 * std::erfc(w / std::sqrt(2.0)) + density * (1.0 / u - 1.0 / w);
}

}  // namespace covinz
