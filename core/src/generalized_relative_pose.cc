#include "covinz/generalized_relative_pose.h"

#include <algorithm>
#include <cmath>

#include "covinz/five_point.h"
#include "covinz/se3.h"

namespace covinz {
namespace {

Eigen::Matrix3d NearestRotation(const Eigen::Matrix3d& almost) {
  return Eigen::Quaterniond(almost).normalized().toRotationMatrix();
}

// Up to sign, the direction t of E = [t]x R: normal to all columns of E.
Eigen::Vector3d DirectionOf(const Eigen::Matrix3d& E) {
  Eigen::Vector3d best = Eigen::Vector3d::Zero();
  for (int c = 0; c < 3; ++c) {
    const Eigen::Vector3d cross = E.col(c).cross(E.col((c + 1) % 3));
    if (cross.squaredNorm() > best.squaredNorm()) best = cross;
  }
  return best.normalized();
}

// The four poses of E: (t, R), (-t, R) and the same with the other rotation. With t.t = 1 and E of
// Frobenius norm sqrt(2), the cofactors of E = [t]x R are t t^T R and [t]x E = (t t^T - 1) R.
std::array<UnscaledPose, 4> Decompose(const Eigen::Matrix3d& E) {
  const Eigen::Vector3d t = DirectionOf(E);
  const Eigen::Matrix3d scaled = std::sqrt(2.0) / E.norm() * E;
  Eigen::Matrix3d cofactors;
  for (int c = 0; c < 3; ++c) {
    cofactors.col(c) = scaled.col((c + 1) % 3).cross(scaled.col((c + 2) % 3));
  }
  const Eigen::Matrix3d tE = Hat(t) * scaled;
  const Eigen::Matrix3d R = NearestRotation(cofactors - tE);
  const Eigen::Matrix3d R_other = NearestRotation(cofactors + tE);
  return {UnscaledPose{R, t}, UnscaledPose{R, -t}, UnscaledPose{R_other, t},
          UnscaledPose{R_other, -t}};
}

Eigen::Vector3d Baseline(const Eigen::Isometry3d& T_cand_query, const RayMatch& match) {
  return T_cand_query * match.query_centre - match.cand_centre;
}

}  // namespace

RayMatch RayMatchOf(const RigPairs& rigs, size_t pair, size_t i) {
  const BearingPairs& pairs = rigs.pairs[pair];
  const Eigen::Isometry3d& T_query_cam = rigs.T_query_cam[static_cast<size_t>(pairs.query_cam)];
  const Eigen::Isometry3d& T_cand_cam = rigs.T_cand_cam[static_cast<size_t>(pairs.cand_cam)];
  return {T_query_cam.translation(), T_query_cam.linear() * pairs.query[i],
          T_cand_cam.translation(), T_cand_cam.linear() * pairs.cand[i]};
}

bool MeetInFront(const Eigen::Vector3d& query_ray,
                 const Eigen::Vector3d& cand_ray,
                 const Eigen::Vector3d& baseline,
                 double parallel_rad) {
  // Least squares of  depth_query * query_ray + baseline = depth_cand * cand_ray,  as in
  // epipolar.h.
  const double cosine = query_ray.dot(cand_ray);
  if (1.0 - cosine * cosine < parallel_rad * parallel_rad) return cosine > 0.0;
  const double along_query = query_ray.dot(baseline);
  const double along_cand = cand_ray.dot(baseline);
  return cosine * along_cand > along_query && along_cand > cosine * along_query;
}

std::vector<UnscaledPose> FivePointPoses(const std::array<RayMatch, 5>& matches,
                                         double parallel_rad) {
  std::array<Eigen::Vector3d, 5> query, cand;
  for (size_t i = 0; i < 5; ++i) {
    query[i] = matches[i].query_ray;
    cand[i] = matches[i].cand_ray;
  }
  std::vector<UnscaledPose> poses;
  // In the axes of the bodies, so R is that of the bodies already.
  for (const Eigen::Matrix3d& E : FivePointEssentialMatrices(query, cand)) {
    for (const UnscaledPose& pose : Decompose(E)) {
      const bool in_front = std::all_of(matches.begin(), matches.end(), [&](const RayMatch& m) {
        return MeetInFront(pose.R_cand_query * m.query_ray, m.cand_ray, pose.direction,
                           parallel_rad);
      });
      if (in_front) poses.push_back(pose);
    }
  }
  return poses;
}

std::optional<Eigen::Isometry3d> ScaleByRay(const UnscaledPose& pose,
                                            const RayMatch& first,
                                            const RayMatch& other) {
  const Eigen::Vector3d normal = (pose.R_cand_query * other.query_ray).cross(other.cand_ray);
  const Eigen::Vector3d v = pose.R_cand_query * (other.query_centre - first.query_centre) -
                            (other.cand_centre - first.cand_centre);
  const double distance = -v.dot(normal) / pose.direction.dot(normal);
  if (!(distance > 0.0 && std::isfinite(distance))) return std::nullopt;
  Eigen::Isometry3d T_cand_query = Eigen::Isometry3d::Identity();
  T_cand_query.linear() = pose.R_cand_query;
  T_cand_query.translation() =
      distance * pose.direction + first.cand_centre - pose.R_cand_query * first.query_centre;
  return T_cand_query;
}

std::vector<Eigen::Isometry3d> SolveFivePlusOne(const std::array<RayMatch, 6>& matches,
                                                double parallel_rad) {
  std::array<RayMatch, 5> five;
  std::copy_n(matches.begin(), 5, five.begin());
  const RayMatch& sixth = matches[5];
  std::vector<Eigen::Isometry3d> poses;
  for (const UnscaledPose& pose : FivePointPoses(five, parallel_rad)) {
    const std::optional<Eigen::Isometry3d> T_cand_query = ScaleByRay(pose, five[0], sixth);
    if (T_cand_query && MeetInFront(pose.R_cand_query * sixth.query_ray, sixth.cand_ray,
                                    Baseline(*T_cand_query, sixth), parallel_rad)) {
      poses.push_back(*T_cand_query);
    }
  }
  return poses;
}

}  // namespace covinz
