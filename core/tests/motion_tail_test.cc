// The tail of odometry's losses against closed forms and drawn residuals.
#include "covinz/motion_tail.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "../src/rig_adjustment.h"
#include "covinz/rig_refinement.h"

namespace covinz {
namespace {

TEST(MotionTail, OfOneMotionIsThatOfABetaVariable) {
  for (const double cost : {25.0, 40.0, 60.0, 80.0}) {
    // Beta(2, 3) below b, for four degrees of freedom.
    const double b = std::exp(-cost / 10.0);
    const double exact = b * b * (6.0 - 8.0 * b + 3.0 * b * b);
    EXPECT_NEAR(MotionCostTail(cost, 1, 4.0) / exact, 1.0, 0.1) << cost;
  }
}

TEST(MotionTail, OfThreeMotionsIsThatOfDrawnStudentResiduals) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal;
  RigRefinementOptions options;
  std::vector<double> costs(100000, 0.0);
  for (double& cost : costs) {
    for (int motion = 0; motion < 3; ++motion) {
      double square = 0.0;
      double chi2 = 0.0;
      for (int i = 0; i < 6; ++i) square += std::pow(normal(engine), 2);
      for (int i = 0; i < 4; ++i) chi2 += std::pow(normal(engine), 2);
      // Student's, as wide as the loss has it: (dof + 6) / dof times its scale.
      cost += MotionLoss(10.0 / 4.0 * square / (chi2 / 4.0), options).cost;
    }
  }
  std::sort(costs.begin(), costs.end());
  for (const double tail : {0.1, 0.01, 0.003}) {
    const double cost = costs[static_cast<size_t>((1.0 - tail) * 1e5)];
    EXPECT_NEAR(MotionCostTail(cost, 3, 4.0) / tail, 1.0, 0.15) << tail;
  }
}

TEST(MotionTail, OfTheLargestIsThatOfBetaVariables) {
  const double b = std::exp(-4.0);
  const double one = b * b * (6.0 - 8.0 * b + 3.0 * b * b);
  EXPECT_NEAR(LargestMotionTail(40.0, 1, 4.0), one, 1e-12);
  EXPECT_NEAR(LargestMotionTail(40.0, 3, 4.0), 1.0 - std::pow(1.0 - one, 3), 1e-12);
  EXPECT_NEAR(LargestMotionTail(0.0, 3, 4.0), 1.0, 1e-12);
}

TEST(MotionTail, OneImpossibleMotionOrSeveralImprobableOnesAreRejected) {
  EXPECT_EQ(MotionProbability({}, 4.0), 1.0);
  EXPECT_EQ(MotionProbability({5.0, 8.0, 2.0}, 4.0), 1.0);
  // One motion of eight standard deviations is what tails are for.
  EXPECT_GT(MotionProbability({10.0 * std::log(1.0 + 6.4), 5.0, 5.0}, 4.0), 0.05);
  EXPECT_LT(MotionProbability({52.0, 3.0, 3.0}, 4.0), 0.002);
  EXPECT_LT(MotionProbability({38.0, 35.0, 4.0}, 4.0), 0.005);
}

TEST(MotionTail, FallsFromOne) {
  EXPECT_EQ(MotionCostTail(0.0, 3, 4.0), 1.0);
  double last = 1.0;
  for (double cost = 40.0; cost < 200.0; cost += 5.0) {
    const double tail = MotionCostTail(cost, 3, 4.0);
    EXPECT_LT(tail, last);
    last = tail;
  }
}

}  // namespace
}  // namespace covinz
