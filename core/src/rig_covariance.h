// The honest covariance of a rig refinement.
#pragma once

#include <Eigen/Core>

#include "covinz/rig_refinement.h"
#include "rig_adjustment.h"

namespace covinz {

struct AdjustmentCovariance {
  Eigen::MatrixXd cameras;  // of the perturbations of all cameras but camera 0
  ResidualStatistics residuals;
};

// Two variance components of the keypoints' errors are estimated from their residuals: a part of
// its own for each keypoint (variance i^2), and one that all keypoints within a cell of one image
// share (s^2): what blur, rolling shutter, an imperfect calibration and descriptors that look alike
// do to neighbours alike. Averaging many keypoints does away with the first part only. With e the
// whitened residuals, M what the fit leaves of errors (e = M error), C the sums over cells,
//
//   E[e^T e] = i^2 tr(M) + s^2 tr(K),   E[|C^T e|^2] = i^2 tr(K) + s^2 tr(K^2),   K = C^T M C,
//
// and the covariance of the cameras, H the reduced Hessian and A = d(gradient) / d(cell errors), is
//
//   H^-1 (H_motions + i^2 H_keypoints + s^2 A A^T) H^-1.
//
// i is never taken below 1, s never below 0: no evidence is no reason for more confidence than the
// noise model has.
//
// Source: Rao, "Estimation of variance and covariance components: MINQUE theory", J. Multivariate
// Analysis 1971; Moulton, "Random group effects and the precision of regression estimates",
// J. Econometrics 1986.
AdjustmentCovariance EstimateCovariance(const RigAdjustment& problem,
                                        const RigAdjustmentState& state);

}  // namespace covinz
