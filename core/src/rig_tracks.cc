// Union-find over keypoints that never puts two keypoints of one camera into a track.
#include "covinz/rig_tracks.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <tuple>

namespace covinz {
namespace {

// Keypoints of all cameras in one numbering, ascending in camera and row.
class KeypointForest {
 public:
  explicit KeypointForest(const std::vector<TrackLink>& links) {
    for (const TrackLink& link : links) {
      Reserve(link.a);
      Reserve(link.b);
    }
    for (size_t c = 1; c < begins_.size(); ++c) begins_[c] += begins_[c - 1];
    parents_.resize(static_cast<size_t>(begins_.back()));
    std::iota(parents_.begin(), parents_.end(), 0);
    cameras_.resize(parents_.size());
    for (size_t c = 0; c + 1 < begins_.size(); ++c) {
      std::fill(cameras_.begin() + begins_[c], cameras_.begin() + begins_[c + 1], 1u << c);
    }
  }

  int Node(const TrackObservation& observation) const {
    return begins_[static_cast<size_t>(observation.camera)] + observation.keypoint;
  }

  // The smallest node of its tree, so that the result is independent of the order of unions.
  int Root(int node) {
    while (parent(node) != node) {
      parent(node) = parent(parent(node));
      node = parent(node);
    }
    return node;
  }

  // Whether both are in one tree afterwards.
  bool Unite(int a, int b) {
    a = Root(a);
    b = Root(b);
    if (a == b) return true;
    uint32_t& cameras_a = cameras_[static_cast<size_t>(a)];
    uint32_t& cameras_b = cameras_[static_cast<size_t>(b)];
    if ((cameras_a & cameras_b) != 0) return false;
    cameras_a = cameras_b = cameras_a | cameras_b;
    parent(std::max(a, b)) = std::min(a, b);
    return true;
  }

  size_t NumNodes() const { return parents_.size(); }

 private:
  int& parent(int node) { return parents_[static_cast<size_t>(node)]; }

  void Reserve(const TrackObservation& observation) {
    const size_t next = static_cast<size_t>(observation.camera) + 1;
    if (begins_.size() <= next) begins_.resize(next + 1, 0);
    begins_[next] = std::max(begins_[next], observation.keypoint + 1);
  }

  std::vector<int> begins_{0};     // first node of each camera
  std::vector<int> parents_;       // by node
  std::vector<uint32_t> cameras_;  // of the tree, by its root: a bit a camera
};

void CheckLinks(const std::vector<TrackLink>& links) {
  for (const TrackLink& link : links) {
    for (const TrackObservation* o : {&link.a, &link.b}) {
      if (o->camera < 0 || o->camera > 31 || o->keypoint < 0) {
        throw std::invalid_argument("TrackLink: cameras are 0 to 31, keypoints 0 or more");
      }
    }
    if (link.a.camera == link.b.camera) {
      throw std::invalid_argument("TrackLink: both keypoints are of one camera");
    }
  }
}

// Positions of the links, smallest error first; equal ones in the order of their keypoints.
std::vector<size_t> OrderLinks(std::vector<TrackLink>& links) {
  for (TrackLink& link : links) {
    if (link.b.camera < link.a.camera) std::swap(link.a, link.b);
    if (std::isnan(link.error)) link.error = std::numeric_limits<double>::infinity();
  }
  std::vector<size_t> order(links.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::sort(order.begin(), order.end(), [&links](size_t i, size_t j) {
    const TrackLink& x = links[i];
    const TrackLink& y = links[j];
    if (x.error != y.error) return x.error < y.error;
    return std::tie(x.a.camera, x.a.keypoint, x.b.camera, x.b.keypoint) <
           std::tie(y.a.camera, y.a.keypoint, y.b.camera, y.b.keypoint);
  });
  return order;
}

}  // namespace

RigTracks MergeTracks(std::vector<TrackLink> links) {
  CheckLinks(links);
  const std::vector<size_t> order = OrderLinks(links);
  KeypointForest forest(links);
  std::vector<const TrackObservation*> observations(forest.NumNodes(), nullptr);
  for (const size_t n : order) {
    const TrackLink& link = links[n];
    if (!forest.Unite(forest.Node(link.a), forest.Node(link.b))) continue;
    observations[static_cast<size_t>(forest.Node(link.a))] = &link.a;
    observations[static_cast<size_t>(forest.Node(link.b))] = &link.b;
  }
  // Nodes ascend in camera and row, and a root is its tree's smallest: counting sort by root.
  std::vector<int> places(forest.NumNodes() + 1, 0);
  for (size_t n = 0; n < observations.size(); ++n) {
    if (observations[n]) ++places[static_cast<size_t>(forest.Root(static_cast<int>(n))) + 1];
  }
  RigTracks tracks;
  tracks.begins.push_back(0);
  for (size_t n = 1; n < places.size(); ++n) {
    const int size = places[n];
    places[n] += places[n - 1];
    if (size > 0) tracks.begins.push_back(places[n]);
  }
  tracks.observations.resize(static_cast<size_t>(places.back()));
  for (size_t n = 0; n < observations.size(); ++n) {
    if (!observations[n]) continue;
    const size_t root = static_cast<size_t>(forest.Root(static_cast<int>(n)));
    tracks.observations[static_cast<size_t>(places[root]++)] = *observations[n];
  }
  return tracks;
}

RigTracks ThinTracks(const RigTracks& tracks, int max_num_tracks) {
  if (tracks.NumTracks() <= max_num_tracks) return tracks;
  RigTracks thinned;
  thinned.begins.push_back(0);
  for (int i = 0; i < max_num_tracks; ++i) {
    const size_t t = static_cast<size_t>(i) * static_cast<size_t>(tracks.NumTracks()) /
                     static_cast<size_t>(max_num_tracks);
    thinned.observations.insert(thinned.observations.end(),
                                tracks.observations.begin() + tracks.begins[t],
                                tracks.observations.begin() + tracks.begins[t + 1]);
    thinned.begins.push_back(static_cast<int>(thinned.observations.size()));
  }
  return thinned;
}

std::vector<TrackLink> InlierLinks(const RigPairs& rigs,
                                   const std::vector<std::vector<Match>>& keypoints,
                                   const std::vector<std::vector<int>>& inliers,
                                   const Eigen::Isometry3d& T_cand_query) {
  if (keypoints.size() != rigs.pairs.size() || inliers.size() != rigs.pairs.size()) {
    throw std::invalid_argument("InlierLinks: keypoints and inliers for each pair");
  }
  std::vector<TrackLink> links;
  for (size_t p = 0; p < rigs.pairs.size(); ++p) {
    const BearingPairs& pairs = rigs.pairs[p];
    if (keypoints[p].size() != pairs.size()) {
      throw std::invalid_argument("InlierLinks: one row of keypoints for each match");
    }
    const Eigen::Matrix3d E =
        EssentialMatrix(rigs.T_cand_cam.at(static_cast<size_t>(pairs.cand_cam)).inverse() *
                        T_cand_query * rigs.T_query_cam.at(static_cast<size_t>(pairs.query_cam)));
    const int query_cam = static_cast<int>(rigs.T_cand_cam.size()) + pairs.query_cam;
    for (const int inlier : inliers[p]) {
      if (inlier < 0 || static_cast<size_t>(inlier) >= pairs.size()) {
        throw std::invalid_argument("InlierLinks: an inlier that the pair does not have");
      }
      const size_t i = static_cast<size_t>(inlier);
      links.push_back({{pairs.cand_cam, keypoints[p][i].cand, pairs.cand[i]},
                       {query_cam, keypoints[p][i].query, pairs.query[i]},
                       SquaredSampsonError_px2(E, pairs, i)});
    }
  }
  return links;
}

}  // namespace covinz
