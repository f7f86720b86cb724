// Rounds of choosing tracks, dropping those out of the scene, and adjusting.
#include "rig_solution.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace covinz {
namespace {

// How far a refinement goes; rigs are wrong about depths by what a keypoint error of
// depth_sigma_px does.
struct Effort {
  int max_num_tracks;
  int max_num_iterations;
  double depth_sigma_px;
};

// The start's poses also say which tracks contradict one another and which are out of the scene.
RigSolution Refine(const LoopProblem& problem,
                   const RigPoses& start,
                   const std::vector<std::vector<int>>& inliers,
                   const Effort& effort,
                   const FastLoopOptions& options) {
  RigPairs rigs = problem.matched.rigs;
  rigs.T_cand_cam = start.T_cand_cam;
  rigs.T_query_cam = start.T_query_cam;
  RefinedRig cand = problem.cand;
  RefinedRig query = problem.query;
  cand.T_rig_cam = start.T_cand_cam;
  query.T_rig_cam = start.T_query_cam;
  RigRefinementOptions depth_options = options.refinement;
  depth_options.sigma_px = effort.depth_sigma_px;
  RigRefinementOptions refinement_options = options.refinement;
  refinement_options.max_num_iterations = effort.max_num_iterations;
  RigSolution solution;
  const RigTracks tracks =
      MergeTracks(InlierLinks(rigs, problem.matched.keypoints, inliers, start.T_cand_query));
  solution.tracks = ThinTracks(
      DropImplausibleTracks(cand, query, tracks, start.T_cand_query, depth_options, options.depth),
      effort.max_num_tracks);
  solution.refinement =
      RefineRigs(problem.cand, problem.query, solution.tracks, start, refinement_options);
  solution.score = ScoreSolution(problem.matched.rigs, solution.refinement, options.refinement,
                                 options.selection);
  return solution;
}

// Keypoint error [px] that does to depths what the odometry of both rigs does.
double DepthSigma_px(const LoopProblem& problem, const RigRefinementOptions& options) {
  double sigma_px = options.sigma_px;
  for (const RefinedRig* rig : {&problem.cand, &problem.query}) {
    for (const RigMotion& motion : rig->motions) {
      const double turn_rad = std::sqrt(motion.covariance.diagonal().head<3>().maxCoeff());
      sigma_px = std::max(sigma_px, std::hypot(options.sigma_px, turn_rad * rig->focal_px[0]));
    }
  }
  return sigma_px;
}

}  // namespace

RigSolution RefineTrial(const LoopProblem& problem,
                        const std::vector<std::vector<int>>& inliers,
                        const RigPoses& start,
                        const FastLoopOptions& options) {
  const Effort effort{options.max_num_trial_tracks, options.max_num_trial_iterations,
                      DepthSigma_px(problem, options.refinement)};
  return Refine(problem, start, inliers, effort, options);
}

RigSolution RefineTrial(const LoopProblem& problem,
                        const std::vector<std::vector<int>>& inliers,
                        const Eigen::Isometry3d& T_cand_query,
                        const FastLoopOptions& options) {
  return RefineTrial(problem, inliers,
                     RigPoses{problem.cand.T_rig_cam, problem.query.T_rig_cam, T_cand_query},
                     options);
}

RigSolution RefineToTheEnd(const LoopProblem& problem,
                           RigPoses start,
                           std::vector<std::vector<int>> inliers,
                           const FastLoopOptions& options) {
  const Effort effort{std::numeric_limits<int>::max(), options.refinement.max_num_iterations,
                      options.refinement.sigma_px};
  RigSolution solution;
  for (int round = 0; round < options.max_num_rounds; ++round) {
    size_t num_inliers = 0;
    for (const std::vector<int>& of_pair : inliers) num_inliers += of_pair.size();
    solution = Refine(problem, start, inliers, effort, options);
    const bool converged =
        solution.refinement.num_iterations < options.refinement.max_num_iterations;
    if (converged && solution.score.num_inliers <= 1.02 * static_cast<double>(num_inliers)) break;
    start = solution.Poses();
    inliers = solution.score.inliers;
  }
  return solution;
}

RigSolution RefineToTheEnd(const LoopProblem& problem,
                           const RigSolution& trial,
                           const FastLoopOptions& options) {
  return RefineToTheEnd(problem, trial.Poses(), trial.score.inliers, options);
}

}  // namespace covinz
