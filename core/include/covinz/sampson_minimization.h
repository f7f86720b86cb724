// The relative pose of two rigid rigs that minimises the Sampson errors of their matches.
#pragma once

#include <Eigen/Geometry>

#include "covinz/rig_sampson.h"

namespace covinz {

// Minimises the biweight cost of RigSampson::Linearize by Levenberg-Marquardt over the six degrees
// of freedom of T_cand_query, at most max_num_iterations steps of up to 0.2 rad and 0.5 m from the
// given pose, on about every stride-th match. Stops when a step is shorter than 1e-4 in
// radians and metres.
//
// Source: Levenberg 1944, Marquardt 1963; the weights are iterated as in Holland and Welsch,
// "Robust regression using iteratively reweighted least-squares", 1977.
Eigen::Isometry3d MinimizeSampson(const RigSampson& sampson,
                                  const Eigen::Isometry3d& T_cand_query,
                                  double max_error_px,
                                  int max_num_iterations,
                                  int stride = 1);

}  // namespace covinz
