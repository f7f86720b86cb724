// Triangulation of tracks, and the tracks that are out of the scene.
#include "covinz/triangulation.h"

#include <random>

#include <gtest/gtest.h>

#include "refinement_problem.h"

namespace covinz {
namespace {

BearingMeasurement Measure(const Eigen::Vector3d& bearing, int camera) {
  return {camera, bearing, TangentBasis(bearing) / 0.002};
}

TEST(TriangulateTrack, FindsThePointWhereRaysMeet) {
  std::mt19937_64 engine(3);
  for (int i = 0; i < 50; ++i) {
    const Eigen::Vector3d position = Eigen::Vector3d(0.0, 0.0, 4.0) + RandomNormal3(engine, 1.0);
    InverseDistancePoint point{position.normalized(), 1.0 / position.norm()};
    if (i % 5 == 0) point.inverse_distance = 0.0;
    std::vector<Eigen::Isometry3d> poses;
    std::vector<BearingMeasurement> track;
    for (int c = 0; c < 2 + i % 4; ++c) {
      poses.push_back(RandomPose(engine, 0.3, 0.4));
      track.push_back(Measure(RayInCamera(point, poses.back()).normalized(), c));
    }
    const InverseDistancePoint found =
        TriangulateTrack(track.data(), track.data() + track.size(), poses, 1e-6);
    EXPECT_LT((found.direction - point.direction).norm(), 1e-6);
    EXPECT_NEAR(found.inverse_distance, point.inverse_distance, 1e-5);
  }
}

TEST(TriangulateTrack, ParallelRaysFromOnePlaceAreNotSingular) {
  const std::vector<Eigen::Isometry3d> poses(2, Eigen::Isometry3d::Identity());
  const std::vector<BearingMeasurement> track{Measure(Eigen::Vector3d::UnitZ(), 0),
                                              Measure(Eigen::Vector3d::UnitZ(), 1)};
  const InverseDistancePoint found = TriangulateTrack(track.data(), track.data() + 2, poses, 0.01);
  EXPECT_LT((found.direction - Eigen::Vector3d::UnitZ()).norm(), 1e-12);
  EXPECT_EQ(found.inverse_distance, 0.0);
}

// Two cameras 0.4 m apart and tracks at the given inverse distances.
struct Scene {
  RefinedRig cand{{Eigen::Isometry3d::Identity()}, {500.0}, {}, {}};
  RefinedRig query = cand;
  Eigen::Isometry3d T_cand_query = Eigen::Isometry3d(Eigen::Translation3d(0.4, 0.0, 0.0));
  RigTracks tracks;

  explicit Scene(const std::vector<double>& inverse_distances) {
    std::vector<TrackLink> links;
    std::mt19937_64 engine(1);
    int row = 0;
    for (const double w : inverse_distances) {
      Eigen::Vector3d direction = Eigen::Vector3d::UnitZ() + RandomNormal3(engine, 0.2);
      const InverseDistancePoint point{direction.normalized(), w};
      links.push_back({{0, row, point.direction},
                       {1, row, RayInCamera(point, T_cand_query).normalized()},
                       0.0});
      ++row;
    }
    tracks = MergeTracks(links);
  }

  // First keypoints of the tracks that are kept.
  std::vector<int> Kept(const TrackDepthOptions& options = {}) const {
    const RigTracks kept = DropImplausibleTracks(cand, query, tracks, T_cand_query, {}, options);
    std::vector<int> rows;
    for (int t = 0; t < kept.NumTracks(); ++t) {
      rows.push_back(kept.observations[size_t(kept.begins[size_t(t)])].keypoint);
    }
    return rows;
  }
};

TEST(DropImplausibleTracks, DropsWhatIsFarNearerThanTheSceneAndWhatIsBehind) {
  // The scene is 2 m to 10 m away and at infinity; then 0.3 m, and behind the cameras.
  std::vector<double> scene;
  for (int i = 0; i < 40; ++i) scene.push_back(0.1 + 0.01 * i);
  scene.push_back(0.0);
  const int num_good = int(scene.size());
  scene.push_back(3.3);
  scene.push_back(-0.5);
  std::vector<int> expected(static_cast<size_t>(num_good));
  for (int i = 0; i < num_good; ++i) expected[size_t(i)] = i;
  EXPECT_EQ(Scene(scene).Kept(), expected);
}

TEST(DropImplausibleTracks, UncertainDepthsAreKept) {
  // At 0.4 m of baseline and 500 px, a pixel is an inverse distance of 0.005.
  std::vector<double> scene(20, 0.2);
  scene.push_back(0.3 + 0.01);
  scene.push_back(-0.01);
  EXPECT_EQ(Scene(scene).Kept().size(), scene.size());
  TrackDepthOptions strict;
  strict.max_sigmas = 0.0;
  EXPECT_EQ(Scene(scene).Kept(strict).size(), scene.size() - 2);
}

TEST(DropImplausibleTracks, NoTracksStayNone) { EXPECT_TRUE(Scene({}).Kept().empty()); }

TEST(DropImplausibleTracks, KeepsNearlyAllTracksOfGeneratedLoops) {
  for (uint64_t seed = 0; seed < 10; ++seed) {
    RefinementProblemOptions options;
    options.seed = seed;
    const RefinementProblem problem = MakeRefinementProblem(options);
    RefinedRig cand = problem.cand;
    RefinedRig query = problem.query;
    cand.T_rig_cam = problem.T_cand_cam;
    query.T_rig_cam = problem.T_query_cam;
    const RigTracks tracks = problem.Tracks(problem.T_cand_query);
    const RigTracks kept = DropImplausibleTracks(cand, query, tracks, problem.T_cand_query, {}, {});
    EXPECT_GT(kept.NumTracks(), 0.93 * tracks.NumTracks());
  }
}

TEST(TrackDepthOptions, Check) {
  const auto throws = [](auto change) {
    TrackDepthOptions options;
    change(options);
    EXPECT_THROW(options.Check(), std::invalid_argument);
  };
  EXPECT_NO_THROW(TrackDepthOptions{}.Check());
  throws([](TrackDepthOptions& o) { o.scene_quantile = 1.5; });
  throws([](TrackDepthOptions& o) { o.max_times_nearer = 0.5; });
  throws([](TrackDepthOptions& o) { o.max_sigmas = -1.0; });
}

}  // namespace
}  // namespace covinz
