// Essential matrices of five matches of two single cameras.
#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>

namespace covinz {

// Up to ten real E, each of Frobenius norm one, with cand[i]^T E query[i] = 0 for five matches of
// unit bearings; empty for degenerate matches.
//
// E = x X + y Y + z Z + W in the null space of the five epipolar constraints; det E = 0 and
// 2 E E^T E - tr(E E^T) E = 0 are ten cubics in x, y, z, which elimination turns into a polynomial
// of degree ten in z.
//
// Source: Nister, "An efficient solution to the five-point relative pose problem", TPAMI 2004.
std::vector<Eigen::Matrix3d> FivePointEssentialMatrices(const std::array<Eigen::Vector3d, 5>& query,
                                                        const std::array<Eigen::Vector3d, 5>& cand);

}  // namespace covinz
