// How improbable it is that odometry is as wrong as a loop would have it.
#pragma once

#include <vector>

namespace covinz {

// Probability that the losses of `num_motions` motions of a rig (RigRefinementOptions.motion_dof)
// add up to `cost` or more, were their residuals from the Student distribution that the loss stands
// for. With L the loss of one, 1 / (1 + s / (dof + 6)) = exp(-L / (dof + 6)) is of the Beta(dof /
// 2, 3) distribution, so L / (dof + 6) is a sum of three exponential variables of rates dof / 2,
// dof / 2 + 1 and dof / 2 + 2. The tail of the sum over all motions by its saddlepoint, within a
// few percent; at or below the mean of the sum, 1. The residuals of a fit are no larger than those
// of the truth, so the test rather keeps a wrong loop than rejects a right one.
//
// Source: Lugannani and Rice, "Saddle point approximation for the distribution of the sum of
// independent random variables", Adv. Appl. Prob. 1980; Renyi, "On the theory of order statistics",
// 1953 (logarithm of a Beta variable); decision 0025.
double MotionCostTail(double cost, int num_motions, double dof);

// Probability that the largest of the losses of `num_motions` motions is `cost` or more, likewise;
// exact.
double LargestMotionTail(double cost, int num_motions, double dof);

// Probability of losses as improbable as these: twice the lesser one of the tails of their sum and
// of their largest, so that one motion that is far off is seen as well as all being somewhat off. 1
// at most.
//
// Source: Bonferroni's inequality.
double MotionProbability(const std::vector<double>& costs, double dof);

}  // namespace covinz
