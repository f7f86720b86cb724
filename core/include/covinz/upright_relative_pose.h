// The upright four-point minimal solver: metric relative pose of two rigs that know the vertical.
#pragma once

#include <array>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/generalized_relative_pose.h"

namespace covinz {

// Directions of the vertical, unit vectors in the two body frames; both up or both down.
struct Verticals {
  Eigen::Vector3d query;
  Eigen::Vector3d cand;
};

// All T_cand_query that turn one vertical into the other and satisfy the epipolar constraints of
// four matches of two camera pairs or more, with all four points in front of their cameras. Rays
// that are parallel to within parallel_rad count as in front. Matches of a single pair, whose scale
// is unobservable, give nothing of use.
//
// With z vertical on both sides and (1 + s^2) R = C + s B + s^2 A, the rotation about it in terms
// of s = tan(angle / 2), match i gives one row of
//
//   M(s) (t, 1)^T = 0,   row i = ((R q x c)^T, c . R (p_q x q) + (p_c x c) . R q):
//
// the generalized epipolar constraint. det M(s) is a polynomial of degree eight.
//
// Source: Sweeney, Flynn, Turk, "Solving for relative pose with a partially known rotation is a
// quadratic eigenvalue problem", 3DV 2014; the determinant is expanded here instead.
std::vector<Eigen::Isometry3d> SolveUprightFourPoint(const std::array<RayMatch, 4>& matches,
                                                     const Verticals& verticals,
                                                     double parallel_rad);

}  // namespace covinz
