// The twin of a flat scene: it explains what the truth explains, and its twin is the truth.
#include "covinz/planar_twin.h"

#include <random>

#include <gtest/gtest.h>

#include "rig_problem.h"

namespace covinz {
namespace {

// Points of a plane in front of a camera.
std::vector<InverseDistancePoint> Wall(const Eigen::Vector3d& normal) {
  std::vector<InverseDistancePoint> points;
  std::mt19937_64 engine(1);
  for (int i = 0; i < 100; ++i) {
    const Eigen::Vector3d direction =
        (Eigen::Vector3d::UnitZ() + RandomNormal3(engine, 0.3)).normalized();
    points.push_back({direction, normal.dot(direction)});
  }
  return points;
}

TEST(PlanarTwin, ExplainsTheSameViewsOfAPlane) {
  std::mt19937_64 engine(2);
  int num_twins = 0;
  for (int i = 0; i < 20; ++i) {
    const Eigen::Isometry3d T_a_b = RandomPose(engine, 0.3, 0.5);
    const std::vector<InverseDistancePoint> wall =
        Wall((Eigen::Vector3d::UnitZ() + RandomNormal3(engine, 0.2)) / 3.0);
    const std::optional<Eigen::Isometry3d> twin = PlanarTwin(T_a_b, wall);
    ASSERT_TRUE(twin);
    EXPECT_TRUE(twin->linear().isUnitary(1e-9));
    if (PoseError(T_a_b, *twin).norm() > 0.05) ++num_twins;
    // Every ray of b meets its ray of a: the epipolar constraint holds for the twin too.
    for (const InverseDistancePoint& point : wall) {
      const Eigen::Vector3d ray_b = RayInCamera(point, T_a_b).normalized();
      const Eigen::Matrix3d E = EssentialMatrix(*twin) / twin->translation().norm();
      EXPECT_NEAR(point.direction.dot(E * ray_b), 0.0, 1e-6);
    }
  }
  EXPECT_GT(num_twins, 15);
}

TEST(PlanarTwin, OfTheTwinIsTheTruth) {
  std::mt19937_64 engine(3);
  for (int i = 0; i < 20; ++i) {
    const Eigen::Isometry3d T_a_b = RandomPose(engine, 0.2, 0.4);
    const Eigen::Vector3d normal = (Eigen::Vector3d::UnitZ() + RandomNormal3(engine, 0.2)) / 3.0;
    const std::vector<InverseDistancePoint> wall = Wall(normal);
    const Eigen::Isometry3d twin = PlanarTwin(T_a_b, wall).value();
    // The wall as the twin sees it: triangulated from both rays.
    std::vector<InverseDistancePoint> seen;
    for (const InverseDistancePoint& point : wall) {
      const Eigen::Vector3d ray = twin.linear() * RayInCamera(point, T_a_b);
      // direction - w t is parallel to ray.
      const Eigen::Vector3d across = ray.cross(twin.translation());
      seen.push_back(
          {point.direction, ray.cross(point.direction).dot(across) / across.squaredNorm()});
    }
    const Eigen::Isometry3d back = PlanarTwin(twin, seen).value();
    EXPECT_LT(PoseError(T_a_b, back).head<3>().norm(), 1e-6);
    // Its scale is that of the scene's mean, so nearly the truth's.
    EXPECT_LT((T_a_b.translation().normalized() - back.translation().normalized()).norm(), 1e-6);
    EXPECT_NEAR(back.translation().norm() / T_a_b.translation().norm(), 1.0, 1e-6);
  }
}

TEST(PlanarTwin, OutliersOfThePlaneHardlyMatter) {
  std::mt19937_64 engine(4);
  const Eigen::Isometry3d T_a_b = RandomPose(engine, 0.2, 0.4);
  std::vector<InverseDistancePoint> wall = Wall(Eigen::Vector3d::UnitZ() / 3.0);
  const Eigen::Isometry3d clean = PlanarTwin(T_a_b, wall).value();
  for (size_t i = 0; i < wall.size(); i += 10) wall[i].inverse_distance += 1.0;
  const Eigen::Isometry3d twin = PlanarTwin(T_a_b, wall).value();
  EXPECT_LT(PoseError(clean, twin).head<3>().norm(), 0.05);
}

TEST(PlanarTwin, NoneWithoutPlaneOrTranslation) {
  const Eigen::Isometry3d T = Eigen::Isometry3d(Eigen::Translation3d(0.3, 0.0, 0.0));
  EXPECT_FALSE(PlanarTwin(T, {}));
  EXPECT_FALSE(PlanarTwin(T, {{Eigen::Vector3d::UnitZ(), 0.3}, {Eigen::Vector3d::UnitZ(), 0.3}}));
  EXPECT_FALSE(PlanarTwin(Eigen::Isometry3d::Identity(), Wall(Eigen::Vector3d::UnitZ() / 3.0)));
  // At infinity there is no plane.
  EXPECT_FALSE(PlanarTwin(T, Wall(Eigen::Vector3d::Zero())));
}

}  // namespace
}  // namespace covinz
