// Inverse distances of tracks with their uncertainty, and the tracks that are out of the scene.
#include "covinz/triangulation.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "rig_adjustment.h"

namespace covinz {
namespace {

struct InverseDistance {
  double value;
  double sigma;
};

InverseDistance MeasureTrack(const RigAdjustment& problem,
                             const std::vector<Eigen::Isometry3d>& T_world_cam,
                             size_t track) {
  const BearingMeasurement* begin = problem.observations.data() + problem.begins[track];
  const BearingMeasurement* end = problem.observations.data() + problem.begins[track + 1];
  const InverseDistancePoint point =
      TriangulateTrack(begin, end, T_world_cam, problem.inverse_distance_information);
  const Eigen::Matrix<double, 2, 3> basis = TangentBasis(point.direction);
  Eigen::Matrix3d information = problem.PointInformation();
  for (; begin != end; ++begin) {
    const BearingResidual residual =
        EvaluateBearing(*begin, point, basis, T_world_cam[static_cast<size_t>(begin->camera)]);
    information += residual.J_point.transpose() * residual.J_point;
  }
  return {point.inverse_distance, std::sqrt(information.inverse()(2, 2))};
}

}  // namespace

void TrackDepthOptions::Check() const {
  if (!(scene_quantile >= 0.0 && scene_quantile <= 1.0)) {
    throw std::invalid_argument("TrackDepthOptions.scene_quantile must be in [0, 1]");
  }
  if (!(max_times_nearer >= 1.0 && max_sigmas >= 0.0)) {
    throw std::invalid_argument(
        "TrackDepthOptions: times nearer of 1 or more, sigmas of 0 or more");
  }
}

RigTracks DropImplausibleTracks(const RefinedRig& cand,
                                const RefinedRig& query,
                                const RigTracks& tracks,
                                const Eigen::Isometry3d& T_cand_query,
                                const RigRefinementOptions& refinement_options,
                                const TrackDepthOptions& options) {
  refinement_options.Check();
  options.Check();
  cand.Check();
  query.Check();
  const RigAdjustment problem = MakeAdjustment(cand, query, tracks, refinement_options);
  const std::vector<Eigen::Isometry3d> T_world_cam =
      CamerasInWorld(cand.T_rig_cam, query.T_rig_cam, T_cand_query);
  std::vector<InverseDistance> distances;
  std::vector<double> values;
  for (size_t t = 0; t < problem.NumTracks(); ++t) {
    distances.push_back(MeasureTrack(problem, T_world_cam, t));
    values.push_back(distances.back().value);
  }
  if (values.empty()) return tracks;
  const auto quantile =
      values.begin() +
      static_cast<std::ptrdiff_t>(options.scene_quantile * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), quantile, values.end());
  const double nearest = options.max_times_nearer * std::max(0.0, *quantile);

  RigTracks kept;
  kept.begins.push_back(0);
  for (size_t t = 0; t < distances.size(); ++t) {
    const double slack = options.max_sigmas * distances[t].sigma;
    if (!(distances[t].value >= -slack && distances[t].value <= nearest + slack)) continue;
    kept.observations.insert(kept.observations.end(),
                             tracks.observations.begin() + tracks.begins[t],
                             tracks.observations.begin() + tracks.begins[t + 1]);
    kept.begins.push_back(static_cast<int>(kept.observations.size()));
  }
  return kept;
}

}  // namespace covinz
