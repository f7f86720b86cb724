"""Recordings in the TUM layout: exact stamps, ranges, frames, and errors that name the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from covinz_agents.selection import select_keyframes
from covinz_agents.source import DatasetError
from covinz_agents.tum import TumRecording, read_image_list

from covinz import evaluation, frames
from covinz.config import validate
from covinz.scenario import TumAgent, load_scenario
from covinz.trajectory import Trajectory, TrajectoryError, write_tum

SCENARIOS = Path(__file__).resolve().parents[3] / "scenarios"
START_NS = 1_403_636_580_838_560_001
SECOND = 1_000_000_000
NUM_IMAGES = 6


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Six images a second apart, moving 1 m each along the optical axis, camera 0.5 m ahead."""
    rng = np.random.default_rng(0)
    lines = ["# timestamp filename"]
    stamps = START_NS + SECOND * np.arange(NUM_IMAGES)
    for i, stamp in enumerate(stamps.tolist()):
        image = cv2.resize(rng.integers(256, size=(30, 40), dtype=np.uint8), (160, 120))
        cv2.imwrite(str(tmp_path / f"{2 * i:06d}.png"), image)
        lines.append(f"{stamp // SECOND}.{stamp % SECOND:09d} {2 * i:06d}.png")
    (tmp_path / "rgb.txt").write_text("\n".join(lines) + "\n")
    z = 10.0 + np.arange(NUM_IMAGES)
    poses = frames.transform(np.eye(3), z[:, None] * [0.0, 0.0, 1.0])
    write_tum(tmp_path / "odometry.tum", Trajectory(stamps, poses))
    write_tum(tmp_path / "truth.tum", Trajectory(stamps, poses))
    T_body_cam = frames.transform(np.eye(3), [0.0, 0.0, 0.5])
    calibration = {
        "model": "PINHOLE",
        "width": 160,
        "height": 120,
        "params": [100.0, 100.0, 80.0, 60.0],
        "T_body_cam": T_body_cam.ravel().tolist(),
    }
    (tmp_path / "calib.yaml").write_text(yaml.safe_dump(calibration))
    return tmp_path


def agent(folder: Path, **changes: Any) -> TumAgent:
    entries: dict[str, Any] = {
        "id": "a0",
        "reader": "tum",
        "path": folder,
        "odometry": {"source": "file", "file": "odometry.tum", "frame": "camera"},
        "groundtruth": {"file": "truth.tum", "frame": "camera"},
    }
    return validate(TumAgent, entries | changes, "test")


def numbers(recording: TumRecording) -> list[int]:
    return [frame.number for frame in recording.frames]


def test_stamps_are_exact_and_frames_have_their_files_number(folder: Path) -> None:
    recording = TumRecording(agent(folder))
    assert numbers(recording) == [0, 2, 4, 6, 8, 10]
    assert [f.stamp_ns for f in recording.frames] == [
        START_NS + SECOND * i for i in range(NUM_IMAGES)
    ]
    assert recording.skipped == 0


def test_names_that_are_not_all_numbers_count_as_rows(folder: Path) -> None:
    text = (folder / "rgb.txt").read_text().replace("000004.png", "000004b.png")
    (folder / "rgb.txt").write_text(text)
    assert [image.number for image in read_image_list(folder, Path("rgb.txt"))] == list(range(6))


def test_both_ends_of_a_range_of_frames_belong_to_it(folder: Path) -> None:
    assert numbers(TumRecording(agent(folder, frames=[2, 7]))) == [2, 4, 6]


def test_both_ends_of_a_range_of_times_belong_to_it_to_the_nanosecond(folder: Path) -> None:
    first, last = "1403636581.838560001", "1403636583.838560001"
    assert numbers(TumRecording(agent(folder, times_s=[first, last]))) == [2, 4, 6]
    after = "1403636581.838560002"
    assert numbers(TumRecording(agent(folder, times_s=[after, last]))) == [4, 6]


def test_odometry_is_of_the_body_and_starts_at_the_first_frame_used(folder: Path) -> None:
    recording = TumRecording(agent(folder, frames=[4, 10]))
    assert np.allclose(recording.frames[0].T_odom_body, np.eye(4))
    assert np.allclose([f.T_odom_body[2, 3] for f in recording.frames], [0, 1, 2, 3])
    assert recording.groundtruth is not None
    assert np.allclose(recording.groundtruth.T_ref_body[0, :3, 3], [0, 0, 9.5])


def test_camera_and_body_odometry_differ_by_the_extrinsics(folder: Path) -> None:
    """A body that turns on the spot moves its camera."""
    stamps = START_NS + SECOND * np.arange(2)
    T_odom_body = frames.transform(frames.so3_exp([[0.0, 0, 0], [0, 0.4, 0]]), np.zeros((2, 3)))
    T_body_cam = frames.transform(np.eye(3), [0.0, 0.0, 0.5])
    write_tum(folder / "odometry.tum", Trajectory(stamps, T_odom_body @ T_body_cam))
    as_camera = TumRecording(agent(folder)).frames[1].T_odom_body
    assert np.allclose(as_camera, T_odom_body[1], atol=1e-8)
    body = {"source": "file", "file": "odometry.tum", "frame": "body"}
    as_body = TumRecording(agent(folder, odometry=body)).frames[1].T_odom_body
    assert np.linalg.norm(as_body[:3, 3]) == pytest.approx(2 * 0.5 * np.sin(0.2), rel=1e-6)


def test_poses_are_interpolated_within_the_gap_and_images_without_one_are_counted(
    folder: Path,
) -> None:
    keep = np.array([0, 1, 3])
    stamps = START_NS + SECOND * keep
    poses = frames.transform(np.eye(3), keep[:, None] * [0.0, 0.0, 1.0])
    write_tum(folder / "odometry.tum", Trajectory(stamps, poses))
    strict = TumRecording(agent(folder))
    assert (numbers(strict), strict.skipped) == ([0, 2, 6], 3)
    tolerant = TumRecording(agent(folder, max_pose_gap_s=2.0))
    assert (numbers(tolerant), tolerant.skipped) == ([0, 2, 4, 6], 2)
    assert np.allclose(tolerant.frames[2].T_odom_body[2, 3], 2.0)


def test_odometry_from_drifting_ground_truth_is_seeded(folder: Path) -> None:
    def played(seed: int) -> TumRecording:
        return TumRecording(
            agent(folder, odometry={"source": "groundtruth_drift", "drift": {"seed": seed}})
        )

    first, same, other = played(1), played(1), played(2)
    for a, b, c in zip(first.frames[1:], same.frames[1:], other.frames[1:], strict=True):
        assert a.T_odom_body.tobytes() == b.T_odom_body.tobytes()
        assert not np.allclose(a.T_odom_body, c.T_odom_body, atol=1e-4)
    assert abs(first.frames[-1].T_odom_body[2, 3] - 5.0) < 0.5


def test_features_and_camera_come_from_the_images(folder: Path) -> None:
    recording = TumRecording(agent(folder))
    assert (recording.camera.width, recording.camera.height) == (160, 120)
    assert len(recording.features(recording.frames[0])) > 20


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1403636590.0\n", r"rgb\.txt:8: expected timestamp and filename"),
        ("1403636590.0 a b\n", r"rgb\.txt:8: expected timestamp and filename"),
        ("14036e5 000012.png\n", r"rgb\.txt:8: not a time stamp"),
        ("1403636580.0 000012.png\n", r"rgb\.txt:8: the time stamps must ascend"),
    ],
)
def test_a_bad_line_in_the_list_is_named(folder: Path, line: str, message: str) -> None:
    with (folder / "rgb.txt").open("a") as images:
        images.write(line)
    with pytest.raises(DatasetError, match=message):
        TumRecording(agent(folder))


def test_missing_files_are_named(folder: Path) -> None:
    with pytest.raises(DatasetError, match=r"cannot read .*other\.txt"):
        TumRecording(agent(folder, images="other.txt"))
    with pytest.raises(TrajectoryError, match=r"cannot read .*gone\.tum"):
        TumRecording(agent(folder, groundtruth={"file": "gone.tum", "frame": "body"}))


def test_an_image_that_is_missing_or_none_is_named_when_it_is_needed(folder: Path) -> None:
    recording = TumRecording(agent(folder))
    (folder / "000002.png").unlink()
    (folder / "000004.png").write_bytes(b"not an image")
    (folder / "000006.png").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"cannot read the image .*000002\.png: No such file"):
        recording.features(recording.frames[1])
    for frame in recording.frames[2:4]:
        with pytest.raises(DatasetError, match=r"is not an image"):
            recording.features(frame)


def test_an_empty_range_is_an_error(folder: Path) -> None:
    with pytest.raises(DatasetError, match="no image in the range"):
        TumRecording(agent(folder, frames=[11, 20]))
    late = Trajectory(np.array([START_NS + 90 * SECOND]), np.eye(4)[None])
    write_tum(folder / "odometry.tum", late)
    with pytest.raises(DatasetError, match="no image of the range has an odometry pose"):
        TumRecording(agent(folder))


@pytest.mark.data
def test_the_thirds_of_redkitchen(recorded_data: Path) -> None:
    """Real drift of 3 to 9 cm a third (data/README.md: 4 to 9), about 30 keyframes each."""
    scenario = load_scenario(SCENARIOS / "redkitchen.yaml", {"COVINZ_DATA": str(recorded_data)})
    for entry, num_keyframes in zip(scenario.agents, (29, 30, 30), strict=True):
        assert isinstance(entry, TumAgent)
        recording = TumRecording(entry)
        keyframes = select_keyframes(recording.frames, entry.keyframes)
        assert len(keyframes) == num_keyframes
        assert recording.skipped == 0
        assert recording.groundtruth is not None
        odometry = Trajectory(
            np.array([frame.stamp_ns for frame in keyframes]),
            np.array([frame.T_odom_body for frame in keyframes]),
        )
        pairs = evaluation.associate(odometry, recording.groundtruth)
        assert len(pairs) == num_keyframes
        assert 0.03 < evaluation.ate_m(pairs) < 0.09
    assert len(recording.features(keyframes[0])) == 1000
