"""Rendered robots: the same images in any order and process, kept, seeded; odometry from files."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from covinz_agents.cache_folder import cache_folder
from covinz_agents.image_cache import ImageCache
from covinz_agents.rendered import RenderedRobot
from covinz_agents.rendering import render_ahead
from covinz_agents.source import DatasetError, RenderingStopped
from covinz_agents.studio import Studio, renderer_sources
from numpy.typing import NDArray

from covinz import frames
from covinz.scenario import RenderedAgent, Scenario
from covinz.trajectory import Trajectory, write_tum
from tests.small_world import arc

# As small as a hall can be: fewer surfaces to paint.
SCENE = {"kind": "hall", "seed": 3, "size_m": [8.0, 7.0, 4.8]}
CAMERA = {
    "model": "PINHOLE",
    "width": 160,
    "height": 120,
    "params": [100.0, 100.0, 79.5, 59.5],
    "T_body_cam": [0, 0, 1, 0.1, -1, 0, 0, 0.0, 0, -1, 0, 0.0, 0, 0, 0, 1],
}


def scenario(seed: int = 0, **changes: Any) -> Scenario:
    agent = {"reader": "rendered", "camera": CAMERA, "path": arc(0.0, 1.0), **changes}
    agents = [{"id": "a0", **agent}, {"id": "a1", **agent, "look": {"light": 1}}]
    return Scenario.model_validate({"name": "x", "seed": seed, "scene": SCENE, "agents": agents})


def robot(given: Scenario, folder: Path, agent_id: str = "a0") -> RenderedRobot:
    agent = given.agent(agent_id)
    assert isinstance(agent, RenderedAgent)
    return RenderedRobot(agent, given, Studio(ImageCache(folder)))


def images(source: RenderedRobot, numbers: list[int]) -> list[bytes]:
    return [source.image(source.frames[number]).tobytes() for number in numbers]


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> list[NDArray[np.uint8]]:
    """Three images of the scenario."""
    source = robot(scenario(), tmp_path_factory.mktemp("images"))
    return [source.image(source.frames[number]) for number in (0, 5, 9)]


def test_images_are_the_same_in_any_order_and_those_of_other_robots_are_not(
    reference: list[NDArray[np.uint8]], tmp_path: Path
) -> None:
    backwards = images(robot(scenario(), tmp_path), [9, 5, 0])[::-1]
    assert backwards == [image.tobytes() for image in reference]
    for image in reference:
        assert image.shape == (120, 160, 3)
        assert image.std() > 5
    others = images(robot(scenario(), tmp_path, "a1"), [0, 5])
    others += images(robot(scenario(seed=1), tmp_path), [0, 5])
    assert len({*backwards, *others}) == 7


@pytest.mark.slow
def test_an_image_is_kept_and_a_damaged_one_is_rendered_again(
    reference: list[NDArray[np.uint8]], tmp_path: Path
) -> None:
    source = robot(scenario(), tmp_path)
    first = source.frames[0]
    assert not source.is_rendered(first)
    source.image(first)
    assert robot(scenario(), tmp_path).is_rendered(first)
    (kept,) = tmp_path.iterdir()
    black = ImageCache(tmp_path).write(kept.stem, np.zeros_like(reference[0]))
    assert np.array_equal(robot(scenario(), tmp_path).image(first), black)
    kept.write_bytes(kept.read_bytes()[:-30])
    assert not source.is_rendered(first)
    assert np.array_equal(robot(scenario(), tmp_path).image(first), reference[0])


@pytest.mark.slow
def test_processes_that_render_ahead_make_the_same_images(tmp_path: Path) -> None:
    given = scenario(seed=5)  # rendered nowhere else: the processes use the cache of all tests
    robots = {name: robot(given, cache_folder("images"), name) for name in ("a0", "a1")}
    numbers = {"a0": [0, 5, 9, 10, 11, 12], "a1": [0, 1]}
    frames_of = {name: [robots[name].frames[i] for i in wanted] for name, wanted in numbers.items()}
    work = {name: (robots[name], frames_of[name]) for name in numbers}
    progress: list[tuple[int, int]] = []
    render_ahead(given, work, threading.Event(), lambda done, all_: progress.append((done, all_)))
    assert progress[0] == (0, 8)
    assert progress[-1] == (8, 8)
    for name, frames_ in frames_of.items():
        assert all(robots[name].is_rendered(frame) for frame in frames_)
    assert images(robots["a0"], [0, 5, 9]) == images(robot(given, tmp_path), [0, 5, 9])
    # The second time there is nothing to do.
    render_ahead(given, work, threading.Event(), lambda done, all_: progress.append((done, all_)))
    assert progress[-1] == (8, 8)
    assert progress.count((0, 8)) == 1


@pytest.mark.slow
def test_rendering_ahead_stops_when_asked_and_says_what_is_wrong(tmp_path: Path) -> None:
    given = scenario(seed=6)
    source = robot(given, tmp_path)
    work = {"a0": (source, source.frames[:2])}
    stop = threading.Event()
    stop.set()
    with pytest.raises(RenderingStopped, match="0 of 2"):
        render_ahead(given, work, stop, lambda *_: None)
    broken = given.model_copy(update={"agents": (given.agent("a1"),)})
    with pytest.raises(KeyError):
        render_ahead(broken, work, threading.Event(), lambda *_: None)


@pytest.mark.slow
def test_a_cache_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="cannot keep a rendered image"):
        source = robot(scenario(), tmp_path / "gone")
        source.image(source.frames[0])


@pytest.mark.slow
def test_motion_blur_smears_along_the_motion(
    reference: list[NDArray[np.uint8]], tmp_path: Path
) -> None:
    blurred = robot(scenario(sensor={"blur_s": 0.4}), tmp_path)
    image = blurred.image(blurred.frames[5])
    sharp, smeared = (
        np.abs(np.diff(i.astype(float), axis=1)).mean() for i in (reference[1], image)
    )
    assert smeared < 0.97 * sharp


def test_odometry_starts_at_the_identity_and_drifts_by_default(tmp_path: Path) -> None:
    source = robot(scenario(), tmp_path)
    assert source.skipped == 0
    assert len(source.frames) == len(source.groundtruth)
    assert np.array_equal(source.frames[0].T_odom_body, np.eye(4))
    truth = source.groundtruth.T_ref_body
    last = source.frames[-1].T_odom_body
    error = frames.local_error(frames.inverse(truth[0]) @ truth[-1], last)
    assert 0 < np.linalg.norm(error[3:]) < 0.2


@pytest.mark.parametrize("whose", ["body", "camera"])
def test_odometry_from_a_file_in_any_frame(tmp_path: Path, whose: str) -> None:
    given = robot(scenario(), tmp_path)
    truth = given.groundtruth
    keep = slice(3, len(truth) - 2)
    T_ref_world = frames.transform(frames.so3_exp([0.0, 0.0, 1.0]), [5.0, 0.0, 1.0])
    T = T_ref_world @ truth.T_ref_body[keep]
    if whose == "camera":
        T = T @ given.camera.T_body_cam
    write_tum(tmp_path / "odometry.tum", Trajectory(truth.stamps_ns[keep], T))
    odometry = {"source": "file", "file": str(tmp_path / "odometry.tum"), "frame": whose}
    source = robot(scenario(odometry=odometry), tmp_path)
    assert source.skipped == 5
    assert [frame.number for frame in source.frames] == list(range(3, len(truth) - 2))
    expected = frames.inverse(truth.T_ref_body[3]) @ truth.T_ref_body[20]
    assert np.allclose(source.frames[17].T_odom_body, expected, atol=1e-7)


def test_odometry_of_another_time_is_an_error(tmp_path: Path) -> None:
    write_tum(tmp_path / "old.tum", Trajectory(np.array([5, 6]), np.stack([np.eye(4)] * 2)))
    odometry = {"source": "file", "file": str(tmp_path / "old.tum"), "frame": "body"}
    with pytest.raises(DatasetError, match="a0: no image has an odometry pose"):
        robot(scenario(odometry=odometry), tmp_path)


def test_a_world_without_room_is_an_error(tmp_path: Path) -> None:
    path = {"kind": "smooth", "min_depth_m": 50.0}
    with pytest.raises(DatasetError, match="a0: "):
        robot(scenario(path=path), tmp_path)


def test_images_are_named_by_all_the_code_that_makes_them() -> None:
    program = (
        "import sys; from covinz_agents.world import renderer, sensor; "
        "print(*(name for name in sys.modules if name.startswith('covinz_agents.world.')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    imported = {name.rpartition(".")[2] for name in done.stdout.split()}
    assert len(imported) > 5
    assert imported <= {path.stem for path in renderer_sources()}


def gravity(source: RenderedRobot) -> NDArray[np.float64]:
    measured = [frame.gravity_body for frame in source.frames]
    return np.stack([down for down in measured if down is not None])


def test_gravity_is_sent_only_when_asked_for_and_with_the_error_asked_for(tmp_path: Path) -> None:
    assert all(frame.gravity_body is None for frame in robot(scenario(), tmp_path).frames)
    sigma_rad = 0.01
    measuring = scenario(gravity_sigma_rad=sigma_rad)
    source = robot(measuring, tmp_path)
    errors_rad = []
    for frame, T_world_body in zip(source.frames, source.groundtruth.T_ref_body, strict=True):
        assert frame.gravity_body is not None
        assert np.linalg.norm(frame.gravity_body) == pytest.approx(1.0)
        down = T_world_body[:3, :3] @ frame.gravity_body
        errors_rad += [down[0], down[1]]
        assert down[2] < -0.99
    assert np.std(errors_rad) == pytest.approx(sigma_rad, rel=0.4)
    again, other = robot(measuring, tmp_path), robot(measuring, tmp_path, "a1")
    np.testing.assert_array_equal(gravity(source), gravity(again))
    assert not np.array_equal(gravity(source), gravity(other))
