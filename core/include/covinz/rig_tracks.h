// Tracks: the keypoints of one scene point in the cameras of two rigs, merged from pairwise
// matches.
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "covinz/matching.h"
#include "covinz/rig_relative_pose.h"

namespace covinz {

// One keypoint of a track. The cameras of both rigs share one numbering: the candidate's first,
// in their order, then the query's.
struct TrackObservation {
  int camera;
  int keypoint;             // row in its camera
  Eigen::Vector3d bearing;  // unit vector in the camera frame
};

// A match between two cameras, of different rigs or of one.
struct TrackLink {
  TrackObservation a;
  TrackObservation b;
  double error;  // the better of two contradicting matches has the smaller one
};

// Observations by track; within a track one a camera, cameras ascending. The tracks ascend in
// their first keypoint (camera, then row).
struct RigTracks {
  std::vector<TrackObservation> observations;
  std::vector<int> begins;  // of each track, and one past the last observation

  int NumTracks() const { return static_cast<int>(begins.size()) - 1; }
};

// Union-find over the keypoints. A link that would put two keypoints of one camera into a track is
// left out; links are taken in ascending error, so the contradiction costs the worst of them, the
// track falls apart there, and the result does not depend on the order of the links. A keypoint
// belongs to one track at most, so its error is counted once.
//
// Source: Moulon and Monasse, "Unordered feature tracking made fast and easy", CVMP 2012, who drop
// contradicting tracks whole.
//
// Throws std::invalid_argument for a camera or keypoint below zero, a camera above 31, or a link
// within one camera.
RigTracks MergeTracks(std::vector<TrackLink> links);

// At most so many of the tracks, evenly over their order.
RigTracks ThinTracks(const RigTracks& tracks, int max_num_tracks);

// Links of the inliers of a hypothesis: keypoints[p][i] are the rows of match i of rigs.pairs[p],
// inliers[p] positions of matches in that pair. Their error is the Sampson error [px^2] at
// T_cand_query. Throws std::invalid_argument where the arrays do not fit the pairs.
std::vector<TrackLink> InlierLinks(const RigPairs& rigs,
                                   const std::vector<std::vector<Match>>& keypoints,
                                   const std::vector<std::vector<int>>& inliers,
                                   const Eigen::Isometry3d& T_cand_query);

}  // namespace covinz
