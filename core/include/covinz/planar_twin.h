// The second reading of a flat scene.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/bearing_residual.h"

namespace covinz {

// Two views of a plane determine a homography, and that has two decompositions into a motion and a
// plane. So a flat scene, or one with little relief for its distance, has a second solution that
// explains nearly all matches: the twin, where translation is traded for rotation. Only relief and
// the views of the rigs' other cameras tell the two apart. Whoever found one must have tried the
// other.
//
// The plane n . x = 1 is fitted to the points (robustly, n . direction = inverse distance). With
// T_a_b = (R, t), points given in a, the homography is  H = R^T (I - t n^T).  The twin's plane is
// taken at the scene's mean inverse distance. Returns nullopt for fewer than three points, where
// there is no plane in front, or for a translation of zero or along the plane's normal, which has
// no twin.
//
// Source: Longuet-Higgins, "The reconstruction of a plane surface from two perspective
// projections", Proc. R. Soc. B 1986; Ma, Soatto, Kosecka, Sastry, "An Invitation to 3-D Vision",
// 2004, theorem 5.19.
std::optional<Eigen::Isometry3d> PlanarTwin(const Eigen::Isometry3d& T_a_b,
                                            const std::vector<InverseDistancePoint>& points_a);

}  // namespace covinz
