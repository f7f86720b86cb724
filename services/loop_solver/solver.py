"""One job to one outcome: fetch the keyframes, form the rigs, ask the numeric core.

The outcome, but for the time it took, depends on the job, the configuration and the logged
keyframes alone; not on the worker, nor on what it solved before.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import covinz_core
import numpy as np

from covinz import codec, frames
from covinz.config import LoopSolverConfig
from covinz.keyframes import CameraNotFound, KeyframeNotFound, KeyframeStore
from covinz.types import (
    FeatureType,
    LoopClosure,
    LoopJob,
    LoopSolution,
    MotionResidual,
    Outcome,
    Rejection,
)
from services.loop_solver.exposures import rig_exposures
from services.loop_solver.kinds import FeaturesExpired, NoSharedKind, shared_kind
from services.loop_solver.motions import consecutive, rig_motions
from services.loop_solver.rig import build_rig
from services.loop_solver.verticals import verticals

Result = covinz_core.LoopEstimate | covinz_core.LoopRejection


class LoopSolver:
    """Verifies candidates with the profile of the configuration.

    Args:
        config: Part of the identity of every job.
        store: Where keyframes and calibrations come from.
        clock_s: Seconds, for `solver_ms`.
    """

    def __init__(
        self,
        config: LoopSolverConfig,
        store: KeyframeStore,
        clock_s: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._config = config
        self._store = store
        self._clock_s = clock_s

    def solve(self, job: LoopJob) -> Outcome:
        """The loop, or why there is none.

        Raises:
            StoreUnavailable: If the keyframes cannot be had now; nothing is decided.
        """
        try:
            verify = self.prepared(job)
        except KeyframeNotFound as error:
            return _rejection(job, "keyframe_missing", str(error))
        except CameraNotFound as error:
            return _rejection(job, "camera_missing", str(error))
        except FeaturesExpired as error:
            return _rejection(job, "features_expired", str(error))
        except NoSharedKind as error:
            return _rejection(job, "feature_kind", str(error))
        except ValueError as error:
            return _rejection(job, "error", str(error))
        start_s = self._clock_s()
        try:
            result = verify()
        except (ValueError, RuntimeError) as error:
            # What a robot sent is no input for the core: final, and nobody else's problem.
            return _rejection(job, "error", str(error))
        outcome = _outcome(job, result, 1e3 * (self._clock_s() - start_s))
        try:
            codec.encode(outcome)
        except ValueError as error:
            # What cannot be sent must not end the worker, or the next one that is lent the job.
            return _rejection(job, "error", str(error))
        return outcome

    def prepared(self, job: LoopJob) -> Callable[[], Result]:
        """The numeric core's part of a job, everything fetched and ready to be called.

        Raises:
            KeyframeNotFound, CameraNotFound, StoreUnavailable: From the store.
            FeaturesExpired, NoSharedKind: If features are not there, or of no common kind.
            ValueError: If the rigs cannot be formed of what the keyframes contain.
        """
        config, store = self._config, self._store
        kind = shared_kind(job, store, config.kinds)
        query = build_rig(job.query_rig, store, kind)
        cand = build_rig(job.cand_rig, store, kind)
        if config.profile == "paper":
            options = loop_options(config, job.seed, kind)
            return lambda: covinz_core.solve_loop(query, cand, options)
        query_rig, cand_rig = (
            covinz_core.LoopRig(
                cameras,
                rig_motions(members, store, config.fast.odometry),
                rig_exposures(members, store, config.fast.readout_s),
            )
            for cameras, members in ((query, job.query_rig), (cand, job.cand_rig))
        )
        fast_options = fast_loop_options(config, job.seed, kind)
        if config.fast.use_verticals:
            fast_options.hypotheses.verticals = verticals(job, store)
        return lambda: covinz_core.solve_loop_fast(query_rig, cand_rig, fast_options)


def loop_options(
    config: LoopSolverConfig, seed: int, kind: FeatureType = FeatureType.ORB
) -> covinz_core.LoopOptions:
    """The core's options for one job of profile `paper` over features of one kind."""
    options = covinz_core.LoopOptions()
    _set_matching(options.matching, config, kind)
    for stage in (options.pair, options.rig, options.scale):
        stage.max_error_px = config.max_error_px
    options.pair.confidence = options.rig.confidence = config.confidence
    options.pair.max_num_iterations = config.max_pair_iterations
    options.rig.max_num_iterations = config.max_rig_iterations
    options.covariance.num_samples = config.num_covariance_samples
    options.covariance.max_num_tries = config.max_covariance_tries
    options.covariance.min_inlier_ratio = config.min_covariance_inlier_ratio
    options.covariance.max_error_px = config.max_covariance_error_px
    options.max_covariance_trace = config.max_covariance_trace
    options.min_num_matches = config.min_pair_matches
    options.min_num_pair_inliers = config.min_pair_inliers
    options.min_num_rig_inliers = config.min_rig_inliers
    options.min_baseline_m = config.min_baseline_m
    options.scale.max_common_centre_ratio = config.max_common_centre_ratio
    if config.max_translation_m is not None:
        options.max_translation_m = config.max_translation_m
    if config.max_rotation_rad is not None:
        options.max_rotation_rad = config.max_rotation_rad
    options.seed = seed
    return options


def fast_loop_options(
    config: LoopSolverConfig, seed: int, kind: FeatureType = FeatureType.ORB
) -> covinz_core.FastLoopOptions:
    """The core's options for one job of profile `fast` over features of one kind."""
    fast = config.fast
    options = covinz_core.FastLoopOptions()
    _set_matching(options.matching, config, kind)
    options.hypotheses.max_error_px = fast.max_error_px
    options.hypotheses.confidence = fast.confidence
    options.hypotheses.max_num_iterations = fast.max_iterations
    options.max_num_refined = fast.max_refined
    options.selection.min_significance = fast.min_significance
    options.max_sigma_translation_m = fast.max_sigma_translation_m
    options.min_num_inliers = config.min_rig_inliers
    options.min_baseline_m = config.min_baseline_m
    if config.max_translation_m is not None:
        options.max_translation_m = config.max_translation_m
    if config.max_rotation_rad is not None:
        options.max_rotation_rad = config.max_rotation_rad
    options.seed = seed
    return options


def _set_matching(
    options: covinz_core.MatchingOptions, config: LoopSolverConfig, kind: FeatureType
) -> None:
    matching = config.matching
    if kind is FeatureType.SIFT:
        options.norm = covinz_core.DescriptorNorm.L2
        options.max_distance = matching.max_sift_distance
    else:
        options.norm = covinz_core.DescriptorNorm.HAMMING
        options.max_distance = matching.max_hamming
    options.max_ratio = matching.max_ratio
    options.mutual = matching.mutual


def _outcome(job: LoopJob, result: Result, solver_ms: float) -> Outcome:
    if isinstance(result, covinz_core.LoopRejection):
        return Rejection(
            job_id=job.id,
            query=job.query,
            cand=job.cand,
            stage=result.stage,
            count=result.count,
            threshold=result.threshold,
            detail=_detail(job, result),
            solver_ms=solver_ms,
            solutions=tuple(
                LoopSolution(found.T_cand_query, found.covariance, found.num_inliers, found.cost)
                for found in result.solutions
            ),
        )
    return LoopClosure(
        job_id=job.id,
        query=job.query,
        cand=job.cand,
        T_cand_query=result.T_cand_query,
        covariance=result.covariance,
        num_inliers=result.num_inliers,
        num_matches=sum(result.num_matches),
        solver_ms=solver_ms,
        motion_residuals=_motion_residuals(job, result),
    )


def _motion_residuals(job: LoopJob, loop: covinz_core.LoopEstimate) -> tuple[MotionResidual, ...]:
    """The core's residuals by keyframes; none where it took the rigs as rigid."""
    if not loop.motion_residuals:
        return ()
    ends = [
        (rig[earlier].keyframe, rig[later].keyframe)
        for rig in (job.cand_rig, job.query_rig)
        for earlier, later in consecutive(rig)
    ]
    return tuple(
        MotionResidual(*names, residual)
        for names, residual in zip(ends, loop.motion_residuals, strict=True)
    )


def _detail(job: LoopJob, rejection: covinz_core.LoopRejection) -> str:
    """What a person wants to know besides the figures."""
    if rejection.pair is not None:
        # Pairs count with the query outermost.
        query, cand = divmod(rejection.pair, len(job.cand_rig))
        return f"{job.query_rig[query].keyframe} with {job.cand_rig[cand].keyframe}"
    if len(rejection.solutions) == 2:
        best, other = rejection.solutions
        error = frames.local_error(best.T_cand_query, other.T_cand_query)
        apart_m, turned_deg = np.linalg.norm(error[3:]), np.rad2deg(np.linalg.norm(error[:3]))
        return (
            f"two solutions {apart_m:.2f} m and {turned_deg:.1f} deg apart, "
            f"with {best.num_inliers} and {other.num_inliers} inliers"
        )
    return ""


def _rejection(job: LoopJob, stage: str, detail: str) -> Rejection:
    return Rejection(
        job_id=job.id,
        query=job.query,
        cand=job.cand,
        stage=stage,
        count=0.0,
        threshold=0.0,
        detail=detail,
        solver_ms=0.0,
    )
