// Tracks: merging, contradictions, independence of the order of links, links of a hypothesis.
#include "covinz/rig_tracks.h"

#include <algorithm>
#include <limits>
#include <random>
#include <set>
#include <utility>

#include <gtest/gtest.h>

#include "refinement_problem.h"

namespace covinz {
namespace {

TrackLink Link(int camera_a, int keypoint_a, int camera_b, int keypoint_b, double error = 1.0) {
  // The bearing tells which keypoint it came from.
  const Eigen::Vector3d a(camera_a, keypoint_a, 0.0);
  const Eigen::Vector3d b(camera_b, keypoint_b, 0.0);
  return {{camera_a, keypoint_a, a}, {camera_b, keypoint_b, b}, error};
}

using Track = std::vector<std::pair<int, int>>;  // camera, keypoint

std::vector<Track> Members(const RigTracks& tracks) {
  std::vector<Track> members;
  for (int t = 0; t < tracks.NumTracks(); ++t) {
    members.emplace_back();
    for (int i = tracks.begins[size_t(t)]; i < tracks.begins[size_t(t) + 1]; ++i) {
      const TrackObservation& o = tracks.observations[size_t(i)];
      EXPECT_EQ(o.bearing, Eigen::Vector3d(o.camera, o.keypoint, 0.0));
      members.back().emplace_back(o.camera, o.keypoint);
    }
  }
  return members;
}

TEST(MergeTracks, JoinsLinksThatShareKeypoints) {
  const auto tracks = Members(MergeTracks({
      Link(3, 7, 0, 5),
      Link(3, 7, 1, 2),
      Link(4, 0, 1, 2),
      Link(4, 9, 2, 1),
  }));
  const std::vector<Track> expected{{{0, 5}, {1, 2}, {3, 7}, {4, 0}}, {{2, 1}, {4, 9}}};
  EXPECT_EQ(tracks, expected);
}

TEST(MergeTracks, NoLinksNoTracks) { EXPECT_EQ(MergeTracks({}).NumTracks(), 0); }

TEST(MergeTracks, LinksWithinARigCount) {
  const auto tracks = Members(MergeTracks({Link(0, 1, 1, 2), Link(1, 2, 3, 4)}));
  EXPECT_EQ(tracks, (std::vector<Track>{{{0, 1}, {1, 2}, {3, 4}}}));
}

TEST(MergeTracks, TheWorstLinkOfAContradictionIsLeftOut) {
  // Keypoints 5 and 6 of camera 0 would meet in one track through 3:7.
  const auto tracks = Members(MergeTracks({
      Link(3, 7, 0, 5, 0.3),
      Link(3, 7, 1, 2, 0.1),
      Link(4, 0, 1, 2, 0.9),
      Link(4, 0, 0, 6, 0.2),
  }));
  const std::vector<Track> expected{{{0, 5}, {1, 2}, {3, 7}}, {{0, 6}, {4, 0}}};
  EXPECT_EQ(tracks, expected);
}

TEST(MergeTracks, AKeypointWhoseOnlyLinkIsLeftOutHasNoTrack) {
  const auto tracks = Members(MergeTracks({Link(3, 7, 0, 5, 0.1), Link(3, 7, 0, 6, 0.2)}));
  EXPECT_EQ(tracks, (std::vector<Track>{{{0, 5}, {3, 7}}}));
}

TEST(MergeTracks, AnErrorThatIsNotANumberIsTheWorst) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto tracks = Members(MergeTracks({Link(3, 7, 0, 5, nan), Link(3, 7, 0, 6, 1e9)}));
  EXPECT_EQ(tracks, (std::vector<Track>{{{0, 6}, {3, 7}}}));
}

TEST(MergeTracks, TheOrderOfLinksDoesNotMatter) {
  std::mt19937_64 engine(1);
  std::vector<TrackLink> links;
  for (int i = 0; i < 400; ++i) {
    const int a = int(engine() % 5);
    const int b = (a + 1 + int(engine() % 4)) % 5;
    links.push_back(Link(a, int(engine() % 60), b, int(engine() % 60), double(engine() % 1000)));
  }
  const auto expected = Members(MergeTracks(links));
  EXPECT_GT(expected.size(), 50u);
  for (int round = 0; round < 5; ++round) {
    std::shuffle(links.begin(), links.end(), engine);
    for (TrackLink& link : links) {
      if (engine() % 2) std::swap(link.a, link.b);
    }
    EXPECT_EQ(Members(MergeTracks(links)), expected);
  }
  std::set<std::pair<int, int>> keypoints;
  for (const Track& track : expected) {
    std::set<int> cameras;
    EXPECT_GE(track.size(), 2u);
    for (const auto& keypoint : track) {
      EXPECT_TRUE(cameras.insert(keypoint.first).second);
      EXPECT_TRUE(keypoints.insert(keypoint).second);
    }
  }
}

TEST(MergeTracks, MalformedLinksThrow) {
  EXPECT_THROW(MergeTracks({Link(-1, 0, 1, 0)}), std::invalid_argument);
  EXPECT_THROW(MergeTracks({Link(0, -1, 1, 0)}), std::invalid_argument);
  EXPECT_THROW(MergeTracks({Link(0, 0, 32, 0)}), std::invalid_argument);
  EXPECT_THROW(MergeTracks({Link(1, 0, 1, 1)}), std::invalid_argument);
}

TEST(ThinTracks, KeepsWholeTracksEvenly) {
  std::vector<TrackLink> links;
  for (int i = 0; i < 10; ++i) links.push_back(Link(0, i, 3, i));
  for (int i = 0; i < 10; i += 2) links.push_back(Link(0, i, 4, i));
  const RigTracks all = MergeTracks(links);
  EXPECT_EQ(Members(ThinTracks(all, 10)), Members(all));
  const std::vector<Track> expected{
      {{0, 0}, {3, 0}, {4, 0}}, {{0, 3}, {3, 3}}, {{0, 6}, {3, 6}, {4, 6}}};
  EXPECT_EQ(Members(ThinTracks(all, 3)), expected);
  EXPECT_EQ(ThinTracks(all, 0).NumTracks(), 0);
}

TEST(InlierLinks, AreTheInliersWithTheirErrors) {
  const RefinementProblem problem = MakeRefinementProblem({});
  const auto inliers = std::vector<std::vector<int>>{{0, 3}, {}, {}, {}, {}, {1}};
  const auto links = InlierLinks(problem.rigs, problem.keypoints, inliers, problem.T_cand_query);
  ASSERT_EQ(links.size(), 3u);
  EXPECT_EQ(links[1].a.camera, 0);  // the candidate's first
  EXPECT_EQ(links[1].b.camera, 3);  // the query's first
  EXPECT_EQ(links[1].a.keypoint, problem.keypoints[0][3].cand);
  EXPECT_EQ(links[1].b.keypoint, problem.keypoints[0][3].query);
  EXPECT_EQ(links[1].b.bearing, problem.rigs.pairs[0].query[3]);
  EXPECT_EQ(links[2].a.camera, 2);
  EXPECT_EQ(links[2].b.camera, 4);
  EXPECT_GT(links[0].error, 0.0);
  EXPECT_LT(links[0].error, 100.0);
}

TEST(InlierLinks, MalformedInputThrows) {
  const RefinementProblem good = MakeRefinementProblem({});
  const auto throws = [&good](auto change) {
    RefinementProblem problem = good;
    change(problem);
    EXPECT_THROW(
        InlierLinks(problem.rigs, problem.keypoints, problem.inliers, problem.T_cand_query),
        std::invalid_argument);
  };
  throws([](RefinementProblem& p) { p.keypoints.pop_back(); });
  throws([](RefinementProblem& p) { p.inliers.pop_back(); });
  throws([](RefinementProblem& p) { p.keypoints[2].pop_back(); });
  throws([](RefinementProblem& p) { p.inliers[2].push_back(100000); });
  throws([](RefinementProblem& p) { p.inliers[2].push_back(-1); });
}

}  // namespace
}  // namespace covinz
