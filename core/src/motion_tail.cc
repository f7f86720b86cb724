// Saddlepoint approximation of the tail of a sum of exponential variables.
#include "covinz/motion_tail.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

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

double LargestMotionTail(double cost, int num_motions, double dof) {
  const double a = 0.5 * dof;
  const double b = std::exp(-cost / (dof + 6.0));
  // Of Beta(a, 3) below b.
  const double one = std::pow(b, a) * (0.5 * (a + 1.0) * (a + 2.0) - a * (a + 2.0) * b +
                                       0.5 * a * (a + 1.0) * b * b);
  return -std::expm1(num_motions * std::log1p(-std::min(one, 1.0)));
}

double MotionProbability(const std::vector<double>& costs, double dof) {
  if (costs.empty()) return 1.0;
  const int num_motions = static_cast<int>(costs.size());
  const double sum = std::accumulate(costs.begin(), costs.end(), 0.0);
  const double largest = *std::max_element(costs.begin(), costs.end());
  return std::min(1.0, 2.0 * std::min(MotionCostTail(sum, num_motions, dof),
                                      LargestMotionTail(largest, num_motions, dof)));
}

}  // namespace covinz
