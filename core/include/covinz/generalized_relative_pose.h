// The 5+1-point minimal solver: metric relative pose of two camera rigs from six matched rays.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include "covinz/rig_relative_pose.h"

namespace covinz {

// A match as two rays: centre of its camera and unit direction, in the body frame of its rig.
struct RayMatch {
  Eigen::Vector3d query_centre;
  Eigen::Vector3d query_ray;
  Eigen::Vector3d cand_centre;
  Eigen::Vector3d cand_ray;
};

// Match i of rigs.pairs[pair].
RayMatch RayMatchOf(const RigPairs& rigs, size_t pair, size_t i);

// Pose of one camera pair: as seen from the candidate's camera, the query's lies in this direction
// (a unit vector in the candidate's body frame), at a distance that two cameras cannot tell.
struct UnscaledPose {
  Eigen::Matrix3d R_cand_query;  // of the bodies
  Eigen::Vector3d direction;
};

// Poses on which five matches of one camera pair agree, in front of both cameras. Rays that are
// parallel to within parallel_rad meet at infinity and count as in front.
//
// Source: five_point.h; Horn, "Recovering baseline and orientation from essential matrix", 1990.
std::vector<UnscaledPose> FivePointPoses(const std::array<RayMatch, 5>& matches,
                                         double parallel_rad);

// T_cand_query with the distance from the ray of another pair, nullopt where the distance is not
// positive or not determined (all cameras of a rig in one place, or a ray in the epipolar plane
// whatever the distance). With first any match of the five's pair and r = R query_ray,
//
//   cand_ray . (b x r) = 0,   b = s direction + v,
//   v = R (query_centre - first.query_centre) - (cand_centre - first.cand_centre):
//
// the generalized epipolar constraint, linear in the distance s.
//
// Source: Pless, "Using many cameras as one", CVPR 2003 (constraint); Zheng and Wu, "Structure from
// motion using structure-less resection", ICCV 2015 (5+1 points).
std::optional<Eigen::Isometry3d> ScaleByRay(const UnscaledPose& pose,
                                            const RayMatch& first,
                                            const RayMatch& other);

// All T_cand_query that satisfy the epipolar constraints of six matches, the first five of one
// camera pair, the sixth of another, with all six points in front of their cameras.
//
// Source: as above; Li, Hartley, Kim, "A linear approach to motion estimation using generalized
// camera models", CVPR 2008 (rigs as generalized cameras).
std::vector<Eigen::Isometry3d> SolveFivePlusOne(const std::array<RayMatch, 6>& matches,
                                                double parallel_rad);

// Whether rays meet in front of both cameras, or are parallel to within parallel_rad; baseline is
// the query's camera as seen from the candidate's, in the frame of the two rays.
bool MeetInFront(const Eigen::Vector3d& query_ray,
                 const Eigen::Vector3d& cand_ray,
                 const Eigen::Vector3d& baseline,
                 double parallel_rad);

}  // namespace covinz
