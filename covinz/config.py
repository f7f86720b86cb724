"""Every default of covinz on one page, with unit and source.

Precedence: default < YAML file < environment (``COVINZ__OPTIMIZER__CAUCHY_SCALE=2``). You do not
need a configuration file; ``python -m covinz.config`` prints the values in force.

Sources: [paper III-B2] is COVINS-G; [public code] are the defaults of its released
implementation; [measured] is explained in the decision or document named.
"""

from __future__ import annotations

import copy
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

PositiveInt = Annotated[int, Field(gt=0)]
Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
# Kinds of local features: `covinz.types.FeatureType`.
FeatureKind = Literal["orb", "sift"]
# Keyframes of one rig: time grows with the product of both sizes.
MAX_RIG_SIZE = 5
M = TypeVar("M", bound=BaseModel)
ENVIRONMENT_PREFIX = "COVINZ__"


class ConfigError(ValueError):
    """A configuration or scenario file that cannot be used; the message says where and why."""


class Section(BaseModel):
    """Base of every section: frozen, and unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class BusConfig(Section):
    """The Zenoh session of every process."""

    # Where everyone connects: tcp/, tls/ or quic/ and host:port.
    endpoint: str = "tcp/127.0.0.1:7447"
    # Where the router listens; empty: at `endpoint`. Beyond this machine only with TLS or QUIC.
    listen: tuple[str, ...] = ()
    # The file NAME.covinz that `covinz roster add` wrote; TLS and QUIC need it. [decision 0024]
    credentials: Path | None = None
    # Folder of the roster: whom the router lets in. None: everybody who can connect.
    roster: Path | None = None
    # The router may listen beyond this machine without encryption: whoever reaches it can send as
    # any robot and read every map. Only for a network that nobody else is on, as in Compose.
    insecure: bool = False
    # Larger messages are refused by the transport. [decision 0002]
    max_message_bytes: PositiveInt = 16 * 1024 * 1024
    # A query without an answer fails after this long. [s]
    query_timeout_s: Positive = 10.0


class IngestConfig(Section):
    """The keyframe log."""

    # An upload larger than this is rejected; 1,000 ORB are 36 kB. [bytes]
    max_upload_bytes: PositiveInt = 1024 * 1024
    # A keyframe with more features, of all kinds together, is rejected.
    max_features: PositiveInt = 8192
    # Keyframes committed and acked together (group commit).
    max_batch: PositiveInt = 64
    # A page of the log ends at this size. [bytes; decision 0002]
    page_bytes: PositiveInt = 1024 * 1024
    # Uploads waiting for a commit; beyond it agents are told to retry.
    inbox: PositiveInt = 256
    # The same for a single agent, so that one that floods takes no place of the others.
    # [four times `agent.window`]
    inbox_per_agent: PositiveInt = 16
    # Calibrations that one agent may register.
    max_cameras_per_agent: PositiveInt = 256
    # What an agent is told to wait when the inbox is full. [s]
    retry_after_s: Positive = 0.5
    # The same when the disk is full: it goes on this long after there is room. [s]
    trouble_retry_after_s: Positive = 2.0
    # Beyond this size of the log the features of its oldest keyframes are dropped, their poses are
    # kept; None: never. [bytes; decision 0029]
    max_log_bytes: PositiveInt | None = None
    # The same after so many days of running; None: never. [days; decision 0029]
    max_features_days: Positive | None = None


class RigConfig(Section):
    """Which keyframes form a rig with the query and with the candidate; source: decision 0021."""

    # The nearest in order of the log, or by geometry; None leaves it to the solver's profile:
    # `paper` takes the nearest, `fast` chooses. [paper III-B2]
    neighbours: Literal["index", "geometry"] | None = None
    # Keyframes of the query's rig, the query among them. [paper III-B2: 2]
    query_size: Annotated[int, Field(ge=2, le=MAX_RIG_SIZE)] = 2
    # Keyframes of the candidate's rig, the candidate among them. [paper III-B2: 3]
    cand_size: Annotated[int, Field(ge=2, le=MAX_RIG_SIZE)] = 3
    # Distance of the scene where it matters what two cameras share: the near end of what indoor
    # robots see, since of a distant scene they share more. [m; generated problems: 2 to 15 m]
    depth_m: Positive = 2.0
    # Change of a point's viewing direction [rad], or of the logarithm of its distance, that costs
    # half of the matches. [20 degrees, and two levels of ORB's pyramid; order of magnitude as in
    # Mikolajczyk and Schmid, "A performance evaluation of local descriptors", PAMI 2005]
    half_view_change: Positive = 0.35
    # Cameras in whose view less than this part of the reference's view is form no rig with it if
    # there are better ones.
    min_overlap: Annotated[float, Field(ge=0, le=1)] = 0.5
    # A pair waits for up to two more keyframes of a session if both rigs together would tell the
    # scale with less information than this: 4 is a standard deviation of half the scale.
    min_information: NonNegative = 4.0
    # Keyframes further along the path are not looked at ... [m]
    max_path_m: NonNegative = 2.0
    # ... nor those further away in keyframes: bounds the time of a choice.
    max_steps: Annotated[int, Field(ge=MAX_RIG_SIZE - 1)] = 32


class SiftRecognitionConfig(Section):
    """What SIFT's index has of its own; source: decision 0022."""

    # Vocabulary file; relative to the checkout.
    vocabulary: Path = Path("vocabulary/sift_10k.bin")
    # Two descriptors of one word vote for each other if their codes differ in so many of 128 bits.
    # [measured: decision 0022]
    max_hamming: Annotated[int, Field(gt=0, le=128)] = 28
    # A candidate needs this score; None: the same as of ORB.
    min_score: NonNegative | None = None


class PlaceRecognitionConfig(Section):
    """Candidates for loops. Guards depend on the log alone, never on outcomes."""

    # Vocabulary file of ORB; relative to the checkout.
    vocabulary: Path = Path("vocabulary/orb_10k.bin")
    # Rank by verified votes, or by the paper's DBoW2 tf-idf score. [measured: decision 0004]
    score: Literal["votes", "tf_idf"] = "votes"
    # Two descriptors of one word vote for each other up to this Hamming distance. [measured]
    max_hamming: PositiveInt = 40
    # Candidates passed on per keyframe. [measured: about five]
    num_candidates: PositiveInt = 5
    # A candidate needs this score: idf-weighted votes, or tf-idf in [0, 1].
    min_score: NonNegative = 10.0
    # Candidates need this share of the query's best score. [public code: 0.75 retain rule]
    min_score_ratio: Annotated[float, Field(ge=0, le=1)] = 0.25
    # A keyframe with fewer features of every kind takes no part: it could not pass the gate of the
    # pairs. [paper III-B2: 30 inliers]
    min_features: PositiveInt = 30
    # The first keyframes of a session are neither queries ... [public code: start_after_kf 7]
    start_after_keyframes: Count = 0
    # ... nor candidates. [public code: exclude_kfs_with_id_less_than 7]
    exclude_first_keyframes: Count = 0
    # Candidates of the query's own session are at least so far away along the session, in
    # keyframes [public code: min_loop_dist 100], ...
    min_loop_keyframes: Count = 20
    # ... seconds ...
    min_loop_s: NonNegative = 5.0
    # ... and metres of path.
    min_loop_m: NonNegative = 0.0
    # After a query that gave candidates the session's next keyframes are not queried: keyframes
    # [public code: consecutive_loop_dist 10, there after an accepted loop], ...
    query_spacing_keyframes: Count = 0
    # ... seconds ...
    query_spacing_s: NonNegative = 0.0
    # ... and metres of path.
    query_spacing_m: NonNegative = 0.0
    # Candidates only from other agents. [public code: inter_map_matches_only]
    other_agents_only: bool = False
    # A candidate counts only if a neighbour of it (within this many keyframes) was a candidate
    # of each of so many queries before. 0 switches it off. [public code: 3]
    consistent_queries: Count = 0
    # A lease ends after this long without an outcome. [s]
    lease_s: Positive = 60.0
    # Jobs that may wait for a worker; of more the least useful are given up, and say so. One takes
    # about 8 kB, and 10,000 are two minutes of work for one solver. [decision 0028]
    max_pending_jobs: PositiveInt = 10_000
    # So many failed leases and the job goes to the dead-letter list. [decision 0006]
    max_attempts: PositiveInt = 3
    # How long a worker's request for a job is held open. [s]
    long_poll_s: Positive = 5.0
    # Another vocabulary, and thresholds of its own, for SIFT.
    sift: SiftRecognitionConfig = SiftRecognitionConfig()
    # The keyframes around query and candidate that are matched with them.
    rigs: RigConfig = RigConfig()


class MatchingConfig(Section):
    """Descriptor matching between two images."""

    # Best distance below this share of the second best. [public code: ratio_thres 0.8]
    max_ratio: Annotated[float, Field(gt=0, le=1)] = 0.8
    # ORB: largest Hamming distance. [public code: img_match_thres 40 is stricter]
    max_hamming: PositiveInt = 64
    # SIFT: largest Euclidean distance of bytes, which is at most 724. [public code: 500]
    max_sift_distance: Positive = 500.0
    # Keep a match only if it is the best in both directions. [docs/paper.md]
    mutual: bool = True


class OdometryNoise(Section):
    """Expected accuracy of a front-end as random-walk sigmas; source: paper III-C."""

    # Rotation per square root of metre travelled. [rad / sqrt(m)]
    rotation_per_sqrt_m: NonNegative = 0.01
    # Rotation per square root of radian turned. [rad / sqrt(rad)]
    rotation_per_sqrt_rad: NonNegative = 0.02
    # Translation per square root of metre travelled. [m / sqrt(m)]
    translation_per_sqrt_m: NonNegative = 0.03
    # Translation per square root of radian turned. [m / sqrt(rad)]
    translation_per_sqrt_rad: NonNegative = 0.03
    # Floor of every odometry edge: rotation. [rad]
    min_rotation: Positive = 0.002
    # Floor of every odometry edge: translation. [m]
    min_translation: Positive = 0.003


class FastLoopConfig(Section):
    """What only profile `fast` has; the meaning of each is in core/include/covinz."""

    # A match is an inlier of a hypothesis up to this Sampson error. [px; rig_hypotheses.h]
    max_error_px: Positive = 3.0
    # Probability of having found the best hypothesis; high, since a second one is to be found too.
    confidence: Annotated[float, Field(gt=0, lt=1)] = 0.9999
    # Samples of the joint estimation.
    max_iterations: PositiveInt = 1000
    # Let the direction of gravity propose poses where both robots send it: more loops where most
    # matches are wrong. [decision 0019]
    use_verticals: bool = True
    # Hypotheses that are refined. [real images research: five]
    max_refined: PositiveInt = 5
    # The best solution wins against a distinct one with so many standard deviations, or the loop
    # is ambiguous. [rig_selection.h]
    min_significance: Positive = 3.0
    # Largest predicted standard deviation of the translation. [m; geometry research: 0.3]
    max_sigma_translation_m: Positive = 0.3
    # Accuracy of the motions inside the rigs where a robot sends no covariance.
    odometry: OdometryNoise = OdometryNoise()
    # Time over which an image is exposed where its camera does not say: a rolling shutter read out
    # over a whole frame, stamped anywhere in it. [s; one frame at 30 Hz; decision 0025]
    readout_s: Annotated[float, Field(ge=0, le=1)] = 1 / 30


class LoopSolverConfig(Section):
    """Verification of one candidate. Part of the identity of a job.

    `fast` reads its own section and, of the rest, matching, min_rig_inliers, min_baseline_m and the
    limits on the pose.
    """

    # Joint estimation and refinement, or COVINS-G as written. [decisions 0019 and 0020]
    profile: Literal["fast", "paper"] = "fast"
    fast: FastLoopConfig = FastLoopConfig()
    # Kinds of features in use: a job takes the first one that all its keyframes have. [decision
    # 0022]
    kinds: Annotated[tuple[FeatureKind, ...], Field(min_length=1)] = ("sift", "orb")
    matching: MatchingConfig = MatchingConfig()
    # Matches in each of the six pairs: fewer cannot hold the inliers asked for next.
    min_pair_matches: PositiveInt = 30
    # Inliers of the five-point RANSAC in each of the six pairs. [paper III-B2: 30]
    min_pair_inliers: PositiveInt = 30
    # Inliers of the 17-point RANSAC. [paper III-B2: 100]
    min_rig_inliers: PositiveInt = 100
    # Inlier threshold, in pixels of the actual camera. [docs/paper.md]
    max_error_px: Positive = 2.0
    # Five-point RANSAC iterations per pair.
    max_pair_iterations: PositiveInt = 1000
    # 17-point RANSAC iterations. [public code: 4000]
    max_rig_iterations: PositiveInt = 4000
    # Probability of having drawn a sample without outliers. [OpenGV's default]
    confidence: Annotated[float, Field(gt=0, lt=1)] = 0.99
    # 17-point solves on random inliers for the covariance. [public code: 30]
    num_covariance_samples: PositiveInt = 30
    # Solves that fit badly are drawn again, at most so many in all. [public code: 300]
    max_covariance_tries: PositiveInt = 300
    # A solve fits if it keeps this share of the inliers ... [public code: 0.8]
    min_covariance_inlier_ratio: Annotated[float, Field(gt=0, le=1)] = 0.8
    # ... within this error, in pixels. [public code: 10 px at a focal length of 800]
    max_covariance_error_px: Positive = 6.0
    # Largest trace of the covariance. [rad^2 + m^2; public code: 10]
    max_covariance_trace: Positive = 10.0
    # Two cameras of one rig are further apart than this, or there is no scale. [m]
    min_baseline_m: Positive = 0.01
    # Share of the inliers that cameras without baselines may explain, or scale does not show; 1 is
    # off, as in the paper. [core/include/covinz/rig_scale.h]
    max_common_centre_ratio: Annotated[float, Field(gt=0, le=1)] = 0.8
    # Largest translation between the two keyframes; the paper has no limit. [m; public code: 2]
    max_translation_m: Positive | None = None
    # Largest rotation between them. [rad; public code: 50 degrees of yaw]
    max_rotation_rad: Positive | None = None


class WorkerConfig(Section):
    """A loop-solver process; nothing here changes an outcome."""

    # Keyframes kept in memory (LRU); 36 kB each.
    cache_keyframes: PositiveInt = 1024
    # Back-off between failed attempts to reach another service grows from ... [s]
    min_backoff_s: Positive = 0.05
    # ... to this. [s]
    max_backoff_s: Positive = 2.0


class OptimizerConfig(Section):
    """The pose graph: equation (1) of the paper."""

    # Odometry edges to this many predecessors. [paper III-C: q = 4]
    num_odometry_neighbours: PositiveInt = 4
    # Scale of the Cauchy loss on loop edges, in sigmas: about the root of the six degrees of
    # freedom, so that a true loop is not yet in the tail. [measured: decision 0003; public
    # code: 0.5, reviewers: 1-3]
    cauchy_scale: Positive = 2.5
    # The optimisation starts under a Cauchy loss so many times wider, then takes the real one:
    # true loops that close much drift pull first. 1 switches it off. [measured: decision 0003]
    cauchy_start_factor: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 4.0
    # Levenberg-Marquardt iterations.
    max_iterations: PositiveInt = 100
    # Accuracy of front-ends that send no covariance.
    odometry: OdometryNoise = OdometryNoise()
    # The same for single agents.
    odometry_of: Mapping[str, OdometryNoise] = {}
    # New keyframes alone start an optimisation after this long without other events. [s]
    settle_s: Positive = 1.0
    # While loops keep coming, optimising takes at most this share of the time: what came meanwhile
    # is optimised together. 1: as soon as there is something. [decisions 0032, 0036]
    max_share: Annotated[float, Field(gt=0, le=1)] = 0.05
    # ... but no loop waits longer than this for the next optimisation to begin. [s]
    max_rest_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 2.0
    # A correction that moves further than this since the last one is marked as a jump. [m]
    jump_m: Positive = 0.1
    # The same for rotation. [rad]
    jump_rad: Positive = 0.05


class HealthConfig(Section):
    """How a process is watched; source: decision 0030."""

    # A process whose main loop is busy with one step for longer ends itself, to be started again.
    # [s; the longest right one is the answer with a map of 100,000 keyframes: seconds]
    hang_s: Positive = 60.0
    # The same for one optimisation of a map. [s; 2,500 keyframes with 4,050 loops take 3 s:
    # decision 0023]
    optimisation_s: Positive = 900.0
    # Port of this process's /healthz, /readyz and /metrics; None: none, 0: any, said in the log.
    # `covinz up` gives its processes this one and the following, in the order of `covinz status`.
    port: Annotated[int, Field(ge=0, lt=2**16)] | None = None
    # Where: what is told is no secret of a robot, but also nobody else's business.
    address: str = "127.0.0.1"


class AgentConfig(Section):
    """A robot's side of the upload."""

    # Uploads under way at once. [measured: 2-4]
    window: PositiveInt = 4
    # `send` waits so long for the disk, then the disk follows. With all else it stays below 50 ms.
    # [s; decision 0027]
    max_send_wait_s: NonNegative = 0.01
    # So much may wait for a slow disk before `send` refuses more: half a minute of keyframes of
    # 40 kB at ten a second. [bytes]
    max_unsaved_bytes: PositiveInt = 16 * 1024 * 1024
    # `send` refuses a keyframe larger than this; `ingest.max_upload_bytes` is the server's own
    # limit. [bytes]
    max_keyframe_bytes: PositiveInt = 1024 * 1024
    # The spool drops its oldest keyframes beyond this size and reports a gap. [bytes]
    max_spool_bytes: PositiveInt = 1024 * 1024 * 1024
    # ... and those that have waited longer than this, counted while the robot's program runs, so
    # that no clock that is set makes them old. None: never. [s; a week]
    max_spool_age_s: Positive | None = 7 * 86400.0
    # Uploads that the server refused for good are kept beside the spool up to this size. [bytes]
    max_rejected_bytes: PositiveInt = 64 * 1024 * 1024
    # An upload without an answer is sent again after this long. [s]
    ack_timeout_s: Positive = 10.0
    # Back-off between failed attempts grows from ... [s]
    min_backoff_s: Positive = 0.1
    # ... to this. [s]
    max_backoff_s: Positive = 5.0


class KeyframeSelectionConfig(Section):
    """A keyframe is due when the odometry moved this far since the last one."""

    # [m; public code: t_min 0.15]
    translation_m: Positive = 0.15
    # [rad; public code: r_min 0.15]
    rotation_rad: Positive = 0.15


class SiftConfig(Section):
    """SIFT on the grid of `FeatureConfig`."""

    # As many as ORB.
    num_features: PositiveInt = 1000
    # Threshold of contrast, and the one in cells that stay empty. [OpenCV: 0.04; a third of it, as
    # for ORB]
    contrast_threshold: Positive = 0.04
    min_contrast_threshold: Positive = 0.013


class FeatureConfig(Section):
    """Features on a grid, so that they cover the image. `sift` or `[orb, sift]` will do for it."""

    # What is sent, one block for each kind.
    kinds: Annotated[tuple[FeatureKind, ...], Field(min_length=1)] = ("orb",)
    # ORB. [paper: 1,000 ORB]
    num_features: PositiveInt = 1000
    # Grid cells along the image's width and height. [rendering study: 8 x 6]
    grid: tuple[PositiveInt, PositiveInt] = (8, 6)
    # ORB's pyramid. [public code: 1.2, 8 levels]
    scale_factor: Annotated[float, Field(gt=1)] = 1.2
    num_levels: PositiveInt = 8
    # FAST threshold, and the one tried in cells that stay empty. [public code: 20, 7]
    fast_threshold: PositiveInt = 20
    min_fast_threshold: PositiveInt = 7
    sift: SiftConfig = SiftConfig()

    @model_validator(mode="before")
    @classmethod
    def _from_kinds(cls, values: Any) -> Any:
        if isinstance(values, str):
            return {"kinds": [values]}
        return {"kinds": values} if isinstance(values, list | tuple) else values

    @model_validator(mode="after")
    def _check(self) -> FeatureConfig:
        if len(set(self.kinds)) != len(self.kinds):
            raise ValueError("a kind of feature is named twice")
        return self


Niceness = Annotated[int, Field(ge=0, le=19)]


class NicenessConfig(Section):
    """How much a process gives way to the others of the machine; source: decision 0031.

    Only while there is more to do than the processors can: each step is a fifth less.
    """

    # All that robots send and get goes through it.
    router: Niceness = 0
    # Robots wait for its answers.
    ingest: Niceness = 0
    # May lag behind the log, but no loop can be found before it has found the candidates.
    place_recognition: Niceness = 3
    # Corrections come from it.
    optimizer: Niceness = 3
    # Takes all that is left.
    loop_solver: Niceness = 6


class Config(Section):
    """All sections."""

    bus: BusConfig = BusConfig()
    ingest: IngestConfig = IngestConfig()
    place_recognition: PlaceRecognitionConfig = PlaceRecognitionConfig()
    loop_solver: LoopSolverConfig = LoopSolverConfig()
    worker: WorkerConfig = WorkerConfig()
    optimizer: OptimizerConfig = OptimizerConfig()
    agent: AgentConfig = AgentConfig()
    health: HealthConfig = HealthConfig()
    niceness: NicenessConfig = NicenessConfig()


def load(path: Path | None = None, environ: Mapping[str, str] | None = None) -> Config:
    """Read the configuration: defaults, then the file, then ``COVINZ__SECTION__FIELD``.

    Raises:
        ConfigError: If the file cannot be read or a value is unknown or out of range.
    """
    values = with_environment(read_yaml(path) if path is not None else {}, environ)
    return validate(Config, values, str(path or "environment"))


def with_environment(
    values: Mapping[str, Any], environ: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """`values` with what ``COVINZ__SECTION__FIELD`` says in their place; raises ConfigError."""
    changed = copy.deepcopy(dict(values))
    for name, text in sorted((os.environ if environ is None else environ).items()):
        if name.startswith(ENVIRONMENT_PREFIX):
            _assign(changed, name.removeprefix(ENVIRONMENT_PREFIX).lower().split("__"), text)
    return changed


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML mapping; raises ConfigError when there is none."""
    try:
        values = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        in_one_line = " ".join(str(error).split())
        raise ConfigError(f"cannot read {path}: {in_one_line}") from error
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: expected a mapping of names to values")
    return values


def validate(model: type[M], values: Mapping[str, Any], origin: str) -> M:
    """Build `model` from `values`; raises ConfigError naming every bad entry."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        bad = "; ".join(_complaint(entry["loc"], entry["msg"]) for entry in error.errors())
        raise ConfigError(f"{origin}: {bad}") from error


def _complaint(entry: tuple[int | str, ...], message: str) -> str:
    """One bad entry, e.g. ``optimizer.cauchy_skale: there is no such setting``."""
    if message.startswith("Extra inputs"):
        message = "there is no such setting"
    message = message.removeprefix("Value error, ")
    return ": ".join(filter(None, [".".join(map(str, entry)), message]))


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Nested mapping with the entries of `over` in place of those of `base`."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(below, Mapping) and isinstance(value, Mapping):
            merged[key] = merge(below, value)
        else:
            merged[key] = value
    return merged


def _assign(values: dict[str, Any], path: list[str], text: str) -> None:
    for key in path[:-1]:
        values = values.setdefault(key, {})
        if not isinstance(values, dict):
            raise ConfigError(f"{'.'.join(path)}: {key} is not a section")
    try:
        values[path[-1]] = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{'.'.join(path)}: {text!r} is not a value") from error


if __name__ == "__main__":
    sys.stdout.write(yaml.safe_dump(load().model_dump(mode="json"), sort_keys=False))
