// How wrong a rig refinement is: its covariance, with the noise estimated from the residuals.
#pragma once

#include "covinz/rig_refinement.h"

namespace covinz {

// Options of EstimateRefinementCovariance.
struct RefinementCovarianceOptions {
  // Side of a cell of an image [rad], within which errors count as equal: 4 x 5 cells in an
  // ordinary image.
  double cell_rad = 0.3;
  // Distance over which a shared error fades [rad], a mixture of octaves from here ...
  double min_length_rad = 0.15;
  // ... to here, a few cells to the whole image. Nothing is known about the mixture, so every
  // octave counts alike.
  int num_octaves = 4;
  // The independent part of a keypoint's error is no less than this [px], whatever the residuals
  // say. [corners on a pixel grid: 1 / sqrt(12) for rounding and as much again]
  double min_independent_px = 0.4;

  void Check() const;  // throws std::invalid_argument
};

struct RefinementCovariance {
  // Of the right perturbation of T_cand_query in the query body frame, [rotation, translation],
  // [rad, m]; positive definite.
  Matrix6d covariance;
  // Standard deviation of a keypoint [px], per axis: the part of its own, and the part that it
  // shares with its neighbours in the image.
  double independent_px;
  double shared_px;
  // The same as `covariance` were every error independent and as large as told: the inverse of the
  // Hessian alone. For comparison.
  Matrix6d analytic;
};

// The inverse of the Hessian alone would claim far too much of real images: what blur, rolling
// shutter, an imperfect calibration and descriptors that look alike do to a keypoint they do to its
// neighbours too, and averaging does not help against it. So the errors have two parts, one of each
// keypoint's own (variance i^2) and one that keypoints of an image share the more the nearer they
// are (variance s^2, correlation Q between cells). Both variances are estimated from the residuals
// e. With M what the fit leaves of errors (e = M error) and C the sums over cells,
//
//   E[e^T e]         = i^2 tr(M)   + s^2 tr(Q K),        K = C^T M C,
//   E[e^T C Q C^T e] = i^2 tr(Q K) + s^2 tr(Q K Q K),
//
// and the covariance of the cameras, H the Hessian without the points and A = d gradient / d cells,
// is
//
//   H^-1 (H_motions + i^2 H_keypoints + s^2 A Q A^T) H^-1.
//
// On generated problems, with or without shared errors of 30 to 250 px of length and 0.5 to 1 px of
// size, the mean NEES is 3.5 to 7.5 of an ideal 6; the inverse Hessian has 4 to 30.
//
// Source: Rao, "Estimation of variance and covariance components: MINQUE theory", J. Multivariate
// Analysis 1971; Moulton, "Random group effects and the precision of regression estimates",
// J. Econometrics 1986; decision 0020.
//
// Throws std::invalid_argument on malformed input. `refinement` is what RefineRigs made of the
// other arguments.
RefinementCovariance EstimateRefinementCovariance(const RefinedRig& cand,
                                                  const RefinedRig& query,
                                                  const RigTracks& tracks,
                                                  const RigRefinement& refinement,
                                                  const RigRefinementOptions& refinement_options,
                                                  const RefinementCovarianceOptions& options);

}  // namespace covinz
