// All camera pairs of two rigs, matched.
#include "matched_rigs.h"

namespace covinz {
namespace {

std::vector<int> RowsWithBearing(const RigCamera& camera) {
  std::vector<int> rows;
  for (Eigen::Index i = 0; i < camera.bearings.rows(); ++i) {
    if (camera.bearings.row(i).allFinite()) rows.push_back(static_cast<int>(i));
  }
  return rows;
}

// The features that take part, gathered once for all pairs.
struct Features {
  std::vector<int> rows;
  Descriptors descriptors;
};

std::vector<Features> FeaturesOf(const std::vector<RigCamera>& cameras) {
  std::vector<Features> result;
  for (const RigCamera& camera : cameras) {
    camera.Check();
    result.push_back({RowsWithBearing(camera), {}});
    result.back().descriptors = camera.descriptors(result.back().rows, Eigen::all);
  }
  return result;
}

}  // namespace

MatchedRigs MatchRigs(const std::vector<RigCamera>& query,
                      const std::vector<RigCamera>& cand,
                      const MatchingOptions& options) {
  const std::vector<Features> query_features = FeaturesOf(query);
  const std::vector<Features> cand_features = FeaturesOf(cand);
  MatchedRigs result;
  for (const RigCamera& camera : query) result.rigs.T_query_cam.push_back(camera.T_rig_cam);
  for (const RigCamera& camera : cand) result.rigs.T_cand_cam.push_back(camera.T_rig_cam);
  for (size_t q = 0; q < query.size(); ++q) {
    for (size_t c = 0; c < cand.size(); ++c) {
      BearingPairs pairs;
      pairs.query_cam = static_cast<int>(q);
      pairs.cand_cam = static_cast<int>(c);
      pairs.query_focal_px = query[q].focal_px;
      pairs.cand_focal_px = cand[c].focal_px;
      std::vector<Match> keypoints;
      for (const Match& match :
           MatchDescriptors(query_features[q].descriptors, cand_features[c].descriptors, options)) {
        keypoints.push_back({query_features[q].rows[static_cast<size_t>(match.query)],
                             cand_features[c].rows[static_cast<size_t>(match.cand)]});
        pairs.query.push_back(query[q].bearings.row(keypoints.back().query));
        pairs.cand.push_back(cand[c].bearings.row(keypoints.back().cand));
      }
      result.rigs.pairs.push_back(std::move(pairs));
      result.keypoints.push_back(std::move(keypoints));
    }
  }
  return result;
}

}  // namespace covinz
