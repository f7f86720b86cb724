"""A robot whose camera images are rendered in a generated world: exact truth, no data needed."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.calibration import camera_of
from covinz.config import ConfigError
from covinz.scenario import FileOdometry, RenderedAgent, RenderedPath, Scenario, Scene
from covinz.trajectory import Trajectory, read_tum
from covinz.types import Array, Camera, Features
from covinz_agents.drift import drifting_odometry, seed_of
from covinz_agents.features import extract, extract_kinds
from covinz_agents.paths import given_positions_m, true_path
from covinz_agents.source import DatasetError, Frame
from covinz_agents.studio import Shot, Studio, studio, visit
from covinz_agents.wander import NoFreePath
from covinz_agents.world.build import build_world
from covinz_agents.world.geometry import World

# Motion blur is the mean of so many moments, spread evenly over the exposure.
_BLUR_MOMENTS = 3


class RenderedRobot:
    """A `Source`: a robot on its way through a scenario's world.

    The same scenario and seed give the same images, bit by bit, in whatever order they are asked
    for, on one machine (drivers differ between machines).

    Args:
        agent: The robot.
        scenario: Its scene, seed and the other robots, around whose ways a world may be built.
        pictures: Takes and keeps the images; by default the studio of the process.

    Raises:
        DatasetError: If its world has no such path, or no image has an odometry pose.
        TrajectoryError: If a trajectory file is missing or malformed.
        ConfigError: If the calibration, or the range of a file, is not usable.
    """

    def __init__(
        self, agent: RenderedAgent, scenario: Scenario, pictures: Studio | None = None
    ) -> None:
        self._agent, self._seed = agent, scenario.seed
        self._camera = camera_of(agent.camera, f"{agent.id}: camera")
        self._world = world_of(scenario)
        self._truth = self._true_path()
        self._rows, T_odom_body = self._odometry()
        if not len(self._rows):
            raise DatasetError(f"{agent.id}: no image has an odometry pose")
        self._frames = [
            Frame(int(row), int(self._truth.stamps_ns[row]), T, self._gravity(int(row)))
            for row, T in zip(self._rows, T_odom_body, strict=True)
        ]
        # What is said of the shutter is no part of the lens.
        lens = dataclasses.replace(self._camera, readout_s=None)
        self._visit = visit(self._world, agent.look, lens, agent.sensor)
        self._studio = pictures or studio()

    @property
    def camera(self) -> Camera:
        """Calibration of all frames."""
        return self._camera

    @property
    def world(self) -> World:
        """Where it is; shared by all robots of the scenario."""
        return self._world

    @property
    def frames(self) -> Sequence[Frame]:
        """All images with an odometry pose."""
        return self._frames

    @property
    def skipped(self) -> int:
        """Images left out because the odometry has no pose for them."""
        return len(self._truth) - len(self._frames)

    @property
    def groundtruth(self) -> Trajectory:
        """Exact ``T_world_body`` of every image."""
        return self._truth

    def is_rendered(self, frame: Frame) -> bool:
        """Whether the frame's image is in the cache."""
        return self._studio.has(self._visit, self._shot(frame.number))

    def image(self, frame: Frame) -> NDArray[np.uint8]:
        """A frame's image (H, W, 3) BGR, from the cache or rendered now.

        Raises:
            DatasetError: If the world cannot be drawn, or the cache not written, on this machine.
        """
        return self._studio.picture(self._visit, self._shot(frame.number))

    def features(self, frame: Frame) -> Features:
        """Features of a frame's image, of the first kind; raises as `image`."""
        return extract(self.image(frame), self._agent.features)

    def all_features(self, frame: Frame) -> tuple[Features, ...]:
        """Features of a frame's image, one block for each kind; raises as `image`."""
        return extract_kinds(self.image(frame), self._agent.features)

    def _true_path(self) -> Trajectory:
        agent = self._agent
        try:
            return true_path(
                agent.path,
                self._world,
                agent.frame_rate_hz,
                agent.id,
                self._seed,
                agent.max_pose_gap_s,
            )
        except NoFreePath as error:
            raise DatasetError(f"{agent.id}: {error}") from error

    def _odometry(self) -> tuple[NDArray[np.intp], Array]:
        """Rows of the true path that have a pose, and ``T_odom_body`` (N, 4, 4), first identity."""
        odometry, truth = self._agent.odometry, self._truth
        if not isinstance(odometry, FileOdometry):
            drifted = drifting_odometry(
                truth.T_ref_body, odometry.drift, self._agent.id, self._seed
            )
            return np.arange(len(truth)), drifted
        poses, found = read_tum(odometry.file).sample(
            truth.stamps_ns, round(self._agent.max_pose_gap_s * 1e9)
        )
        if odometry.frame == "camera":
            poses = poses @ frames.inverse(self._camera.T_body_cam)
        return found, frames.inverse(poses[:1]) @ poses

    def _gravity(self, row: int) -> Array | None:
        """Down in the body frame, as an accelerometer would have it."""
        sigma_rad = self._agent.gravity_sigma_rad
        if sigma_rad is None:
            return None
        rng = np.random.default_rng(seed_of("gravity", self._seed, self._agent.id, row))
        error = frames.so3_exp(rng.normal(scale=sigma_rad, size=3))
        down: Array = error @ -self._truth.T_ref_body[row][2, :3]
        return down

    def _shot(self, row: int) -> Shot:
        blur_s = self._agent.sensor.blur_s
        poses = [self._truth.T_ref_body[row]]
        if blur_s > 0:
            moments = (np.arange(_BLUR_MOMENTS) + 0.5) / _BLUR_MOMENTS - 0.5
            poses = [self._at(row, float(moment) * blur_s) for moment in moments]
        seed = seed_of("image", self._seed, self._agent.id, row)
        return Shot(np.stack(poses) @ self._camera.T_body_cam, seed)

    def _at(self, row: int, offset_s: float) -> Array:
        """True pose some time before or after an image; the path ends with its images."""
        stamp_ns = int(self._truth.stamps_ns[row]) + round(offset_s * 1e9)
        pose = self._truth.at(stamp_ns, 2**62)
        found: Array = self._truth.T_ref_body[row] if pose is None else pose
        return found


def world_of(scenario: Scenario) -> World:
    """The world of a scenario's rendered robots, built once in a process."""
    assert scenario.scene is not None  # checked by the scenario
    paths = tuple(agent.path for agent in scenario.agents if isinstance(agent, RenderedAgent))
    return _world(scenario.scene, paths)


@functools.lru_cache(maxsize=2)
def _world(scene: Scene, paths: tuple[RenderedPath, ...]) -> World:
    keep_clear_m = np.concatenate([given_positions_m(path) for path in paths])
    try:
        return build_world(scene, keep_clear_m)
    except ValueError as error:
        raise ConfigError(f"scene: {error}") from error
