// All camera pairs of two rigs, matched.
#include "matched_rigs.h"

#include "covinz/rig_matching.h"

namespace covinz {
namespace {

std::vector<PackedDescriptors> Pack(const std::vector<RigCamera>& cameras) {
  std::vector<PackedDescriptors> packed;
  for (const RigCamera& camera : cameras) {
    camera.Check();
    packed.emplace_back(camera.descriptors, camera.bearings);
  }
  return packed;
}

}  // namespace

MatchedRigs MatchRigs(const std::vector<RigCamera>& query,
                      const std::vector<RigCamera>& cand,
                      const MatchingOptions& options,
                      InstructionSet instruction_set) {
  MatchedRigs result;
  result.keypoints = MatchRigs(Pack(query), Pack(cand), options, instruction_set);
  for (const RigCamera& camera : query) result.rigs.T_query_cam.push_back(camera.T_rig_cam);
  for (const RigCamera& camera : cand) result.rigs.T_cand_cam.push_back(camera.T_rig_cam);
  for (size_t q = 0; q < query.size(); ++q) {
    for (size_t c = 0; c < cand.size(); ++c) {
      BearingPairs pairs;
      pairs.query_cam = static_cast<int>(q);
      pairs.cand_cam = static_cast<int>(c);
      pairs.query_focal_px = query[q].focal_px;
      pairs.cand_focal_px = cand[c].focal_px;
      for (const Match& match : result.keypoints[result.rigs.pairs.size()]) {
        pairs.query.push_back(query[q].bearings.row(match.query));
        pairs.cand.push_back(cand[c].bearings.row(match.cand));
      }
      result.rigs.pairs.push_back(std::move(pairs));
    }
  }
  return result;
}

}  // namespace covinz
