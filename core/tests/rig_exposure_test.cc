// Stamps and shutters against generated problems whose images are of other moments than said.
#include "covinz/rig_exposure.h"

#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Cholesky>

#include "refinement_problem.h"

namespace covinz {
namespace {

constexpr double kStampSigma_s = 1.0 / 30.0 / 3.4641;
constexpr double kRow_s = 1.0 / 30.0 / 480.0;

double Nees(const RigRefinement& found, const Matrix6d& covariance, const Eigen::Isometry3d& T) {
  const Vector6d error = LogSE3(T.inverse() * found.T_cand_query);
  return error.dot(covariance.llt().solve(error));
}

RefinementProblem Problem(uint64_t seed) {
  RefinementProblemOptions options;
  options.seed = seed;
  return MakeRefinementProblem(options);
}

// Every camera turns at a radian a second about an axis of its own and moves at half a metre.
std::vector<CameraExposure> Turning(size_t num_cameras, std::mt19937_64& engine) {
  std::vector<CameraExposure> exposures(num_cameras);
  for (CameraExposure& exposure : exposures) {
    exposure.twist_before << RandomNormal3(engine, 1.0).normalized(),
        0.5 * RandomNormal3(engine, 1.0).normalized();
    exposure.twist_after = exposure.twist_before;
    exposure.stamp_sigma_s = kStampSigma_s;
  }
  return exposures;
}

// The images stay as they are, but the rig is of stamps that are off from them. Returns the
// reference's stamped pose in the frame of its image.
Eigen::Isometry3d Restamp(RefinedRig& rig, std::mt19937_64& engine) {
  std::vector<Eigen::Isometry3d> stamped;
  for (size_t c = 0; c < rig.T_rig_cam.size(); ++c) {
    const double delta_s = RandomNormal3(engine, kStampSigma_s).x();
    stamped.push_back(rig.T_rig_cam[c] * ExpSE3(-delta_s * rig.exposures[c].twist_before));
  }
  for (size_t c = 0; c < stamped.size(); ++c) rig.T_rig_cam[c] = stamped[0].inverse() * stamped[c];
  return stamped[0];
}

TEST(RigExposure, WithTheStampsErrorNeesIsNearSixAndWithoutItFarAbove) {
  double with = 0.0;
  double without = 0.0;
  constexpr int kNumTrials = 40;
  for (uint64_t seed = 0; seed < kNumTrials; ++seed) {
    std::mt19937_64 engine(seed);
    RefinementProblem problem = Problem(seed);
    problem.query.exposures = Turning(problem.query.T_rig_cam.size(), engine);
    problem.cand.exposures = Turning(problem.cand.T_rig_cam.size(), engine);
    const Eigen::Isometry3d query = Restamp(problem.query, engine);
    const Eigen::Isometry3d cand = Restamp(problem.cand, engine);
    const Eigen::Isometry3d truth = cand.inverse() * problem.T_cand_query * query;
    const RigTracks tracks = problem.Tracks(problem.T_cand_query);

    const CalibratedRefinement plain = Refine(problem, tracks, truth);
    without += Nees(plain, plain.covariance, truth) / kNumTrials;

    problem.query.motions = MotionsBetweenImages(problem.query);
    problem.cand.motions = MotionsBetweenImages(problem.cand);
    const CalibratedRefinement widened = Refine(problem, tracks, truth);
    const Matrix6d covariance =
        widened.covariance + StampCovariance(problem.cand, problem.query, widened.T_cand_query);
    with += Nees(widened, covariance, truth) / kNumTrials;
  }
  EXPECT_GT(with, 3.0);
  EXPECT_LT(with, 9.0);
  EXPECT_GT(without, 50.0);
}

// Rows of an image as a turning camera sees them; the middle row is of the pose.
void Roll(const std::vector<CameraExposure>& exposures,
          size_t c,
          std::vector<Eigen::Vector3d>& to) {
  for (Eigen::Vector3d& bearing : to) {
    const double time_s = kRow_s * 458.0 * bearing.y() / bearing.z();
    Vector6d turn = Vector6d::Zero();
    turn.head<3>() = -time_s * exposures[c].twist_before.head<3>();
    bearing = ExpSE3(turn).linear() * bearing;
  }
}

TEST(RigExposure, AnUnknownShutterIsInTheCovariance) {
  double with = 0.0;
  double without = 0.0;
  constexpr int kNumTrials = 40;
  for (uint64_t seed = 0; seed < kNumTrials; ++seed) {
    std::mt19937_64 engine(seed);
    RefinementProblem problem = Problem(seed);
    std::vector<CameraExposure> query = Turning(problem.query.T_rig_cam.size(), engine);
    std::vector<CameraExposure> cand = Turning(problem.cand.T_rig_cam.size(), engine);
    for (std::vector<CameraExposure>* rig : {&query, &cand}) {
      for (CameraExposure& exposure : *rig) {
        // Skews images by a few pixels, as much as the refinement takes for errors of keypoints.
        exposure.twist_before *= 0.3;
        exposure.twist_before.tail<3>().setZero();
        exposure.twist_after = exposure.twist_before;
        exposure.row_s = kRow_s;
      }
    }
    for (BearingPairs& pairs : problem.rigs.pairs) {
      Roll(query, static_cast<size_t>(pairs.query_cam), pairs.query);
      Roll(cand, static_cast<size_t>(pairs.cand_cam), pairs.cand);
    }
    const RigTracks tracks = problem.Tracks(problem.T_cand_query);
    const CalibratedRefinement plain = Refine(problem, tracks, problem.T_cand_query);
    without += Nees(plain, plain.covariance, problem.T_cand_query) / kNumTrials;
    problem.query.exposures = query;
    problem.cand.exposures = cand;
    const CalibratedRefinement told = Refine(problem, tracks, problem.T_cand_query);
    with += Nees(told, told.covariance, problem.T_cand_query) / kNumTrials;
    EXPECT_TRUE(told.T_cand_query.matrix() == plain.T_cand_query.matrix());
  }
  EXPECT_LT(with, 9.0);
  EXPECT_GT(without, 2.0 * with);
}

TEST(RigExposure, CamerasAtRestChangeNoBit) {
  RefinementProblem problem = Problem(3);
  const CalibratedRefinement plain = Refine(problem);
  problem.query.exposures.resize(problem.query.T_rig_cam.size());
  problem.cand.exposures.resize(problem.cand.T_rig_cam.size());
  for (RefinedRig* rig : {&problem.query, &problem.cand}) {
    for (CameraExposure& exposure : rig->exposures) exposure.stamp_sigma_s = exposure.row_s = 0.01;
    const std::vector<RigMotion> motions = MotionsBetweenImages(*rig);
    for (size_t m = 0; m < motions.size(); ++m) {
      EXPECT_TRUE(motions[m].covariance == rig->motions[m].covariance);
    }
  }
  EXPECT_TRUE(Refine(problem).covariance == plain.covariance);
  EXPECT_TRUE(StampCovariance(problem.cand, problem.query, plain.T_cand_query).isZero(0.0));
}

TEST(RigExposure, SwappingTheSidesGivesTheSameErrorSeenFromTheOther) {
  std::mt19937_64 engine(5);
  RefinementProblem problem = Problem(5);
  problem.query.exposures = Turning(problem.query.T_rig_cam.size(), engine);
  problem.cand.exposures = Turning(problem.cand.T_rig_cam.size(), engine);
  const Eigen::Isometry3d& T = problem.T_cand_query;
  const Matrix6d Ad = AdjointSE3(T.inverse());
  const Matrix6d swapped = StampCovariance(problem.query, problem.cand, T.inverse());
  EXPECT_TRUE(StampCovariance(problem.cand, problem.query, T)
                  .isApprox(Ad * swapped * Ad.transpose(), 1e-12));
}

TEST(RigExposure, MalformedExposuresAreRefused) {
  RefinedRig rig = Problem(1).cand;
  rig.exposures.resize(1);
  EXPECT_THROW(rig.Check(), std::invalid_argument);
  rig.exposures.resize(rig.T_rig_cam.size());
  EXPECT_NO_THROW(rig.Check());
  rig.exposures[0].row_s = -1.0;
  EXPECT_THROW(rig.Check(), std::invalid_argument);
  rig.exposures[0] = {};
  rig.exposures[1].twist_after[2] = NAN;
  EXPECT_THROW(rig.Check(), std::invalid_argument);
}

}  // namespace
}  // namespace covinz
