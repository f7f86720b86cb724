// The choice of a rig's neighbours against all rigs there are.
#include "covinz/rig_neighbours.h"

#include <cmath>
#include <random>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

namespace covinz {
namespace {

using Poses = std::vector<Eigen::Isometry3d>;

CameraView Pinhole() {
  return CameraView("PINHOLE", {400.0, 410.0, 300.0, 250.0}, 640, 480,
                    Eigen::Isometry3d::Identity());
}

// Keyframes along the camera's x axis.
Poses Line(const std::vector<double>& steps_m) {
  Poses poses(1, Eigen::Isometry3d::Identity());
  for (const double step_m : steps_m) {
    poses.push_back(poses.back() * Eigen::Translation3d(step_m, 0.0, 0.0));
  }
  return poses;
}

RigChoice Choose(const Poses& poses,
                 const CameraView& view,
                 int reference,
                 int size,
                 const RigNeighboursOptions& options = {}) {
  return ChooseRig(poses, std::vector<const CameraView*>(poses.size(), &view), reference, size,
                   options);
}

TEST(ChooseRig, NoOtherRigTellsMore) {
  RigNeighboursOptions options;
  options.min_overlap = 0.0;
  const CameraView view = Pinhole();
  std::mt19937_64 engine(5);
  std::uniform_real_distribution<double> step_m(0.0, 0.3);
  for (int trial = 0; trial < 20; ++trial) {
    std::vector<double> steps_m(9);
    for (double& step : steps_m) step = step_m(engine);
    const Poses poses = Line(steps_m);
    const int reference = trial % 10;
    const int size = 2 + trial % 4;
    const RigChoice best = Choose(poses, view, reference, size, options);
    // Every set of so many keyframes with the reference; leaving some out does not change the path
    // between the others.
    double most = 0.0;
    for (unsigned set = 0; set < 1u << poses.size(); ++set) {
      Poses some;
      int at = -1;
      for (size_t row = 0; row < poses.size(); ++row) {
        if (!(set >> row & 1u)) continue;
        if (static_cast<int>(row) == reference) at = static_cast<int>(some.size());
        some.push_back(poses[row]);
      }
      if (at < 0 || static_cast<int>(some.size()) != size) continue;
      most = std::max(most, Choose(some, view, at, size, options).information);
    }
    EXPECT_NEAR(best.information, most, 1e-5 * most + 1e-5);
    EXPECT_GT(most, 1.0);
  }
}

TEST(ChooseRig, OfEqualRigsTheNearestIsTaken) {
  const Poses still(9, Eigen::Isometry3d::Identity());
  const RigChoice choice = Choose(still, Pinhole(), 4, 3);
  EXPECT_EQ(choice.rows, (std::vector<int>{4, 3, 5}));
  EXPECT_EQ(choice.information, 0.0);
}

TEST(ChooseRig, FewerKeyframesThanAskedForAreAllTaken) {
  EXPECT_EQ(Choose(Line({}), Pinhole(), 0, 3).rows, (std::vector<int>{0}));
  EXPECT_EQ(Choose(Line({0.1}), Pinhole(), 1, 5).rows, (std::vector<int>{1, 0}));
}

TEST(ChooseRig, AViewWithoutRaysTellsNothing) {
  // No ray of such a camera projects to its corners or borders.
  const CameraView none("OPENCV", {10.0, 10.0, 320.0, 240.0, -5.0, 0.0, 0.0, 0.0}, 640, 480,
                        Eigen::Isometry3d::Identity());
  const RigChoice choice = Choose(Line({0.1, 0.1, 0.1, 0.1}), none, 2, 3);
  EXPECT_EQ(choice.rows, (std::vector<int>{2, 1, 3}));
  EXPECT_EQ(choice.information, 0.0);
}

TEST(ChooseRig, HugeInformationDoesNotOverflow) {
  RigNeighboursOptions options;
  options.odometry = {0.0, 0.0, 0.0, 0.0, 1e-12, 1e-12};
  EXPECT_GT(Choose(Line({0.2, 0.2, 0.2, 0.2}), Pinhole(), 2, 5, options).information, 1e10);
}

TEST(ChooseRig, WhatDoesNotFitIsAnError) {
  const CameraView view = Pinhole();
  const Poses poses = Line({0.1, 0.1});
  EXPECT_THROW(ChooseRig(poses, {&view}, 0, 2, {}), std::invalid_argument);
  EXPECT_THROW(Choose(poses, view, 3, 2), std::invalid_argument);
  EXPECT_THROW(Choose(poses, view, -1, 2), std::invalid_argument);
  EXPECT_THROW(Choose(poses, view, 0, 0), std::invalid_argument);
  RigNeighboursOptions options;
  options.odometry.min_translation = 0.0;
  EXPECT_THROW(Choose(poses, view, 0, 2, options), std::invalid_argument);
}

}  // namespace
}  // namespace covinz
