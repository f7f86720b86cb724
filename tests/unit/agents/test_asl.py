"""Recordings in the ASL layout: the same keyframes as in TUM's, real files' oddities, errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from covinz_agents.asl import AslRecording
from covinz_agents.layouts import write_asl, write_tum_layout
from covinz_agents.recording import RecordedImages
from covinz_agents.selection import select_keyframes
from covinz_agents.source import DatasetError, Source
from covinz_agents.tum import TumRecording

from covinz import codec, frames
from covinz.config import ConfigError, KeyframeSelectionConfig, validate
from covinz.scenario import AslAgent, TumAgent, load_scenario
from covinz.trajectory import Trajectory, TrajectoryError, format_stamp_ns, read_tum, write_tum
from covinz.types import Camera, Keyframe, KeyframeId
from tests.recordings import CAMERAS, START_NS, STEP_NS, T_BODY_CAM, RoomRobot
from tests.uploads import SESSION

FILE = {"source": "file", "file": "odometry.tum", "frame": "body"}
DRIFT = {"source": "groundtruth_drift", "drift": {"seed": 3}}
SCENARIOS = Path(__file__).resolve().parents[3] / "scenarios"
SELECTION = KeyframeSelectionConfig(translation_m=0.2, rotation_rad=0.2)
TRUTH = "mav0/state_groundtruth_estimate0/data.csv"


def asl_agent(folder: Path, **changes: Any) -> AslAgent:
    entries: dict[str, Any] = {"id": "a0", "reader": "asl", "path": folder, "odometry": FILE}
    return validate(AslAgent, entries | changes, "test")


def tum_agent(folder: Path, **changes: Any) -> TumAgent:
    entries: dict[str, Any] = {"id": "a0", "reader": "tum", "path": folder, "odometry": FILE}
    entries["groundtruth"] = {"file": "groundtruth.txt", "frame": "body"}
    return validate(TumAgent, entries | changes, "test")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four images in the ASL layout."""
    write_asl(tmp_path, RoomRobot(num_frames=4))
    return tmp_path


def sent(source: Source, selection: KeyframeSelectionConfig = SELECTION) -> list[bytes]:
    """The messages of all keyframes."""
    messages = []
    for seq, frame in enumerate(select_keyframes(source.frames, selection)):
        name = KeyframeId("a0", SESSION, seq)
        features = source.features(frame)
        hash_ = source.camera.hash
        keyframe = Keyframe(name, frame.stamp_ns, frame.T_odom_body, hash_, features)
        messages.append(codec.encode(keyframe))
    return messages


def edit(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


@pytest.mark.parametrize("model", CAMERAS)
def test_both_layouts_give_the_same_keyframes(tmp_path: Path, model: str) -> None:
    """The same messages, bit by bit; calibration and features are those of the robot itself."""
    robot = RoomRobot(model)
    write_asl(tmp_path / "asl", robot)
    write_tum_layout(tmp_path / "tum", robot)
    asl, tum = AslRecording(asl_agent(tmp_path / "asl")), TumRecording(tum_agent(tmp_path / "tum"))
    assert sent(asl) == sent(tum)
    assert len(sent(asl)) == 4
    assert asl.camera.hash == tum.camera.hash == robot.camera.hash
    assert [frame.stamp_ns for frame in asl.frames] == [frame.stamp_ns for frame in robot.frames]
    for frame, original in zip(asl.frames, robot.frames, strict=True):
        assert np.allclose(frame.T_odom_body, original.T_odom_body, atol=3e-9)
        read, expected = asl.features(frame), robot.features(original)
        assert read.keypoints_px.tobytes() == expected.keypoints_px.tobytes()
        assert read.descriptors.tobytes() == expected.descriptors.tobytes()
    assert asl.groundtruth is not None
    assert tum.groundtruth is not None
    assert asl.groundtruth.stamps_ns.tolist() == robot.groundtruth.stamps_ns.tolist()
    assert np.allclose(asl.groundtruth.T_ref_body, robot.groundtruth.T_ref_body, atol=1e-15)
    assert np.allclose(tum.groundtruth.T_ref_body, robot.groundtruth.T_ref_body, atol=3e-9)


@pytest.mark.parametrize("odometry", [DRIFT, FILE | {"frame": "camera"}])
def test_both_layouts_have_the_same_odometry(tmp_path: Path, odometry: dict[str, Any]) -> None:
    robot = RoomRobot()
    write_asl(tmp_path / "asl", robot)
    write_tum_layout(tmp_path / "tum", robot)
    asl = AslRecording(asl_agent(tmp_path / "asl", odometry=odometry))
    tum = TumRecording(tum_agent(tmp_path / "tum", odometry=odometry))
    for a, b in zip(asl.frames, tum.frames, strict=True):
        assert np.allclose(a.T_odom_body, b.T_odom_body, atol=1e-7)
    assert not np.allclose(asl.frames[-1].T_odom_body, robot.frames[-1].T_odom_body, atol=1e-3)


def test_both_ends_of_a_range_of_times_belong_to_it_to_the_nanosecond(folder: Path) -> None:
    first, last = (format_stamp_ns(START_NS + i * STEP_NS) for i in (1, 2))
    recording = AslRecording(asl_agent(folder, times_s=[first, last]))
    assert [frame.number for frame in recording.frames] == [1, 2]
    after = format_stamp_ns(START_NS + STEP_NS + 1)
    recording = AslRecording(asl_agent(folder, times_s=[after, last]))
    assert [frame.number for frame in recording.frames] == [2]


# A calibration as EuRoC writes it: comments, a matrix over several lines.
EUROC = """# General sensor definitions.
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)

# Sensor extrinsics wrt. the body-frame.
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, -0.02,
         1.0, 0.0, 0.0, -0.06,
         0.0, 0.0, 1.0, 0.01,
         0.0, 0.0, 0.0, 1.0]

# Camera specific definitions.
rate_hz: 20
resolution: [320, 240]
camera_model: pinhole
intrinsics: [195.5, 195.75, 160.25, 119.5] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 2.0e-04, 1.5e-05]
"""
# As Kalibr writes it for TUM-VI: inverse pose, other names, one entry for each camera.
CAMCHAIN = """cam0:
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.06]
  - [-1.0, 0.0, 0.0, -0.02]
  - [0.0, 0.0, 1.0, -0.01]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.0034, 0.0007, -0.002, 0.0002]
  distortion_model: equidistant
  intrinsics: [195.5, 195.75, 160.25, 119.5]
  resolution: [320, 240]
  rostopic: /cam0/image_raw
cam1:
  camera_model: omni
"""
T_BS = np.array([[0, -1, 0, -0.02], [1, 0, 0, -0.06], [0, 0, 1, 0.01], [0, 0, 0, 1]])
OPENCV_MATRIX = EUROC.replace("T_BS:\n", "T_BS: !!opencv-matrix\n").replace(
    "  rows: 4\n", "  rows: 4\n  dt: d\n"
)
FLAT = EUROC.replace("T_BS:\n  cols: 4\n  rows: 4\n  data: ", "T_BS: ")


def read(folder: Path, text: str, newline: str = "\n") -> Camera:
    (folder / "mav0/cam0/sensor.yaml").write_text(text, newline=newline)
    return AslRecording(asl_agent(folder)).camera


@pytest.mark.parametrize(
    "text",
    [
        EUROC,
        f"%YAML:1.0\n---\n{OPENCV_MATRIX}",
        f"%YAML:1.0\n{EUROC}",
        FLAT,
        EUROC.replace("2.0e-04", "2e-4"),
        EUROC.replace("radial-tangential", "radtan"),
        EUROC.replace("\n", "   \n"),
        f"\ufeff{EUROC}",
    ],
)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_calibrations_as_they_are_found(folder: Path, text: str, newline: str) -> None:
    camera = read(folder, text, newline)
    assert camera.model == "OPENCV"
    assert (camera.width, camera.height) == (320, 240)
    expected = [195.5, 195.75, 160.25, 119.5, -0.28, 0.07, 2e-4, 1.5e-5]
    assert camera.params.tolist() == expected
    assert camera.T_body_cam.tolist() == T_BS.tolist()


def test_the_models_have_colmaps_names(folder: Path) -> None:
    line = "distortion_coefficients: [-0.28, 0.07, 2.0e-04, 1.5e-05]\n"
    without = EUROC.replace(line, "").replace("radial-tangential", "none")
    five = EUROC.replace("1.5e-05]", "1.5e-05, 0.1]")
    assert read(folder, without).model == "PINHOLE"
    assert read(folder, f"{without}distortion_coefficients: [0, 0, 0, 0]\n").model == "PINHOLE"
    assert read(folder, EUROC.replace("radial-tangential", "equidistant")).params[4:].tolist() == [
        -0.28,
        0.07,
        2e-4,
        1.5e-5,
    ]
    assert read(folder, five).params[4:].tolist() == [-0.28, 0.07, 2e-4, 1.5e-5, 0.1, 0, 0, 0]


def test_a_rotation_of_few_digits_becomes_a_rotation(folder: Path) -> None:
    R = frames.so3_exp([0.3, -0.4, 0.5])
    text = FLAT.replace("0.0, -1.0, 0.0", ", ".join(f"{value:.4f}" for value in R[0]))
    text = text.replace("1.0, 0.0, 0.0, -0.06", ", ".join(f"{v:.4f}" for v in R[1]) + ", -0.06")
    text = text.replace("0.0, 0.0, 1.0, 0.01", ", ".join(f"{v:.4f}" for v in R[2]) + ", 0.01")
    T_body_cam = read(folder, text).T_body_cam
    assert frames.is_rigid(T_body_cam, 1e-12)
    assert np.allclose(T_body_cam[:3, :3], R, atol=1e-4)


def test_a_camchain_of_kalibr_is_a_calibration(folder: Path) -> None:
    (folder / "dso").mkdir()
    (folder / "dso/camchain.yaml").write_text(CAMCHAIN)
    camera = AslRecording(asl_agent(folder, calibration="dso/camchain.yaml")).camera
    assert camera.model == "OPENCV_FISHEYE"
    assert camera.params.tolist() == [195.5, 195.75, 160.25, 119.5, 0.0034, 0.0007, -0.002, 0.0002]
    assert np.allclose(camera.T_body_cam, T_BS, atol=1e-15)
    (folder / "mav0/cam0").rename(folder / "mav0/cam2")
    second = asl_agent(folder, calibration="dso/camchain.yaml", camera="mav0/cam2")
    with pytest.raises(ConfigError, match=r"camchain\.yaml: there is neither cam2 nor intrinsics"):
        AslRecording(second).camera  # noqa: B018 - reads it


def test_lists_with_windows_lines_blanks_comments_and_bare_headers(folder: Path) -> None:
    expected = sent(AslRecording(asl_agent(folder)))
    for file in (folder / "mav0/cam0/data.csv", folder / TRUTH):
        lines = file.read_text().splitlines()
        lines[0] = lines[0].removeprefix("#")
        lines[1:1] = ["", "# a comment, with a comma", "   "]
        blanks = [line.replace(",", " , ") + "  " for line in lines]
        file.write_text("\ufeff" + "\r\n".join([*blanks, "", ""]), newline="")
    recording = AslRecording(asl_agent(folder))
    assert sent(recording) == expected
    assert recording.groundtruth is not None
    assert len(recording.groundtruth) == 4


def test_images_named_by_their_stamps_need_no_list(folder: Path) -> None:
    expected = sent(AslRecording(asl_agent(folder)))
    camera = folder / "mav0/cam0"
    (camera / "data.csv").unlink()
    assert sent(AslRecording(asl_agent(folder))) == expected
    (folder / "cam0").mkdir()
    for path in (camera / "data").iterdir():
        path.rename(folder / "cam0" / path.name)
    agent = asl_agent(folder, camera="cam0", calibration="mav0/cam0/sensor.yaml")
    assert sent(AslRecording(agent)) == expected


def test_jpg_and_sixteen_bits_are_read(folder: Path) -> None:
    """TUM-VI's png files have 16 bits."""
    data = folder / "mav0/cam0/data"
    first, second, *_ = sorted(data.iterdir())
    image = cv2.imread(str(first), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    expected = AslRecording(asl_agent(folder))
    plain = expected.features(expected.frames[0])
    cv2.imwrite(str(first), image.astype(np.uint16) << 8)
    cv2.imwrite(str(data / f"{second.stem}.jpg"), image)
    edit(
        folder / "mav0/cam0/data.csv", lambda text: text.replace(second.name, f"{second.stem}.jpg")
    )
    recording = AslRecording(asl_agent(folder))
    deep, lossy = (recording.features(frame) for frame in recording.frames[:2])
    assert deep.keypoints_px.tobytes() == plain.keypoints_px.tobytes()
    assert deep.descriptors.tobytes() == plain.descriptors.tobytes()
    assert len(lossy) > 100


def test_columns_after_the_pose_are_those_of_eurocs_estimate(folder: Path) -> None:
    expected = AslRecording(asl_agent(folder)).groundtruth
    edit(folder / TRUTH, lambda text: text.replace("\n1", ",0.1" * 9 + "\n1").rstrip() + ",0.1" * 9)
    edit(folder / TRUTH, lambda text: text.replace("[],0.1,0.1,0.1,0.1,0.1,0.1,0.1,0.1,0.1", "[]"))
    found = AslRecording(asl_agent(folder)).groundtruth
    assert expected is not None
    assert found is not None
    assert found.T_ref_body.tobytes() == expected.T_ref_body.tobytes()


def test_truth_of_markers_becomes_that_of_the_body(folder: Path) -> None:
    """EuRoC's vicon0 is the pose of markers, which its sensor.yaml places on the body."""
    T_body_marker = frames.transform(frames.so3_exp([0.1, 0.2, 0.3]), [0.1, -0.2, 0.3])
    expected = AslRecording(asl_agent(folder)).groundtruth
    assert expected is not None
    truth = RoomRobot(num_frames=4)
    markers = Trajectory(expected.stamps_ns, expected.T_ref_body @ T_body_marker)
    truth.groundtruth = markers
    write_asl(folder / "other", truth)
    mocap = (folder / "other" / TRUTH).rename(folder / "other/mav0/data.csv")
    data = ", ".join(map(repr, T_body_marker.ravel().tolist()))
    mocap.with_name("sensor.yaml").write_text(f"sensor_type: pose\nT_BS: {{data: [{data}]}}\n")
    agent = asl_agent(folder, groundtruth=str(mocap))
    found = AslRecording(agent).groundtruth
    assert found is not None
    assert np.allclose(found.T_ref_body, expected.T_ref_body, atol=1e-12)


def test_truth_may_be_a_tum_file_or_unknown(folder: Path) -> None:
    write_tum(folder / "truth.tum", RoomRobot(num_frames=4).groundtruth)
    recording = AslRecording(asl_agent(folder, groundtruth="truth.tum"))
    assert recording.groundtruth is not None
    expected = read_tum(folder / "truth.tum").T_ref_body
    assert recording.groundtruth.T_ref_body.tobytes() == expected.tobytes()
    assert AslRecording(asl_agent(folder, groundtruth=None)).groundtruth is None
    with pytest.raises(ConfigError, match="drifting ground truth needs groundtruth"):
        asl_agent(folder, groundtruth=None, odometry=DRIFT)
    with pytest.raises(TrajectoryError, match="groundtruth: null says that it is unknown"):
        AslRecording(asl_agent(folder, groundtruth="gone.csv"))


LIST_LINE = f"{START_NS + 3 * STEP_NS},{START_NS + 3 * STEP_NS}.png"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (str(START_NS + STEP_NS * 9), "expected timestamp and filename"),
        (f"{LIST_LINE},x", "expected timestamp and filename"),
        ("1403636579.76,x.png", "not a time stamp in nanoseconds"),
        ("-1403636579,x.png", "not a time stamp in nanoseconds"),
        ("9999999999999999999,x.png", "not a time stamp in nanoseconds"),
        (f"{START_NS + 2 * STEP_NS},x.png", "the time stamps must ascend"),
        (f"{START_NS},x.png", "the time stamps must ascend"),
    ],
)
def test_a_bad_row_of_the_list_is_named(folder: Path, line: str, message: str) -> None:
    edit(folder / "mav0/cam0/data.csv", lambda text: text.replace(LIST_LINE, line))
    with pytest.raises(DatasetError, match=rf"cam0/data\.csv:5: {message}"):
        AslRecording(asl_agent(folder))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (f"{START_NS + STEP_NS},1,2,3", "expected 8 or 17 columns, got 4"),
        (f"{START_NS + STEP_NS},1,2,3,1,0,0,x", "could not convert"),
        (f"{START_NS + STEP_NS},nan,2,3,1,0,0,0", "not a finite pose"),
        (f"{START_NS + STEP_NS},1,2,3,1,1,0,0", "not a finite pose with a unit quaternion w x y z"),
        (f"{START_NS},1,2,3,1,0,0,0", "the time stamps must ascend"),
        ("1.5,1,2,3,1,0,0,0", "not a time stamp in nanoseconds"),
    ],
)
def test_a_bad_row_of_the_truth_is_named(folder: Path, line: str, message: str) -> None:
    lines = (folder / TRUTH).read_text().splitlines()
    (folder / TRUTH).write_text("\n".join([*lines[:2], line, *lines[3:]]))
    with pytest.raises(TrajectoryError, match=rf"estimate0/data\.csv:3: {message}"):
        AslRecording(asl_agent(folder))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("camera_model: pinhole", "camera_model: omni", ":17: camera_model: only pinhole is known"),
        ("radial-tangential", "fov", ":19: distortion_model: 'fov' is none of"),
        ("1.5e-05]", "1.5e-05, 1, 2]", ":20: .*has 4 or 5 coefficients, got 6"),
        (", 1.5e-05]", "]", ":20: distortion_coefficients: radial-tangential has 4 or 5"),
        ("radial-tangential", "equidistant\nx: [", r"cannot read .*line \d+, column"),
        ("radial-tangential", "none", ":20: .*none has no coefficients"),
        (
            "distortion_coefficients",
            "coefficients",
            "there is no distortion_coefficients or distortion_coeffs",
        ),
        ("[-0.28,", "[abc,", ":20: distortion_coefficients: expected numbers"),
        ("[-0.28,", "[.nan,", ":20: distortion_coefficients: not all numbers are finite"),
        ("119.5]", "119.5, 3]", ":18: intrinsics: expected fu, fv, cu, cv"),
        ("[195.5", "[-195.5", ":18: intrinsics: .*positive focal lengths"),
        ("intrinsics: [", "#", ": there is no intrinsics"),
        ("[320, 240]", "[320]", ":16: resolution: expected width and height"),
        ("[320, 240]", "[320.5, 240]", ":16: resolution: expected width and height"),
        ("[320, 240]", "[240, 320]", ": the calibration is for 240 x 320 pixels, .* 320 x 240"),
        ("1.0, 0.0, 0.0, -0.06", "0.9, 0.0, 0.0, -0.06", ":6: T_BS: not a rigid transform"),
        ("0.0, 0.0, 0.0, 1.0]", "0.0, 0.0, 0.1, 1.0]", ":6: T_BS: not a rigid transform"),
        ("0.0, 0.0, 1.0, 0.01", "0.0, 0.0, -1.0, 0.01", ":6: T_BS: not a rigid transform"),
        ("0.0, 0.0, 0.0, 1.0]", "0.0, 0.0, 0.0]", ":6: T_BS: expected a 4 x 4 matrix, got 15"),
        ("T_BS", "T_SB", ": there is no T_BS or T_cam_imu"),
        ("195.5", "1" + 400 * "0", ":18: intrinsics: expected numbers"),
        ("comment: VI-Sensor", "comment: 2020-13-45 #", "cannot read .*month must be in"),
        (EUROC, "- 1\n", ":1: expected a mapping"),
        (EUROC, "", ": expected a mapping"),
    ],
)
def test_a_bad_calibration_is_named(folder: Path, old: str, new: str, message: str) -> None:
    assert old in EUROC
    with pytest.raises(ConfigError, match=message) as caught:
        read(folder, EUROC.replace(old, new))
    assert "mav0/cam0/sensor.yaml" in str(caught.value)


def test_missing_files_are_named(folder: Path) -> None:
    def opened(**changes: Any) -> RecordedImages[AslAgent]:
        recording = AslRecording(asl_agent(folder, **changes))
        recording.camera  # noqa: B018 - reads it
        return recording

    with pytest.raises(DatasetError, match=r"there is no folder .*mav0/cam7"):
        opened(camera="mav0/cam7")
    with pytest.raises(TrajectoryError, match=r"cannot read .*gone\.tum"):
        opened(odometry=FILE | {"file": "gone.tum"})
    with pytest.raises(ConfigError, match=r"cannot read .*gone\.yaml"):
        opened(calibration="gone.yaml")
    with pytest.raises(ConfigError, match=r"cannot read .*gone\.yaml"):
        opened(calibration="gone.yaml", odometry=FILE | {"frame": "camera"})
    recording = opened()
    (folder / f"mav0/cam0/data/{START_NS + STEP_NS}.png").unlink()
    with pytest.raises(DatasetError, match=r"cannot read the image .*No such file"):
        recording.features(recording.frames[1])


def test_an_image_of_another_size_is_named(folder: Path) -> None:
    path = folder / f"mav0/cam0/data/{START_NS + STEP_NS}.png"
    cv2.imwrite(str(path), np.zeros((120, 160), np.uint8))
    recording = AslRecording(asl_agent(folder))
    with pytest.raises(DatasetError, match=f"{path.name} has 160 x 120 pixels, .* 320 x 240"):
        recording.features(recording.frames[1])


def test_an_empty_set_is_an_error(folder: Path) -> None:
    with pytest.raises(DatasetError, match="cam0: no image in the range"):
        AslRecording(asl_agent(folder, times_s=["1", "2"]))
    listed = folder / "mav0/cam0/data.csv"
    listed.write_text("#timestamp [ns],filename\n")
    with pytest.raises(DatasetError, match="cam0: no image in the range"):
        AslRecording(asl_agent(folder))
    listed.unlink()
    for path in (folder / "mav0/cam0/data").iterdir():
        path.unlink()
    with pytest.raises(DatasetError, match=r"no data\.csv, and no image is named by its stamp"):
        AslRecording(asl_agent(folder))
    (folder / TRUTH).write_text("#timestamp\n")
    write_asl(folder / "again", RoomRobot(num_frames=1))
    (folder / "again" / TRUTH).write_text("#timestamp\n")
    with pytest.raises(TrajectoryError, match="there is no pose in it"):
        AslRecording(asl_agent(folder / "again"))


def test_two_images_of_one_time_are_an_error(folder: Path) -> None:
    (folder / "mav0/cam0/data.csv").unlink()
    data = folder / "mav0/cam0/data"
    (data / f"{START_NS}.jpg").write_bytes((data / f"{START_NS}.png").read_bytes())
    with pytest.raises(DatasetError, match="has the same time stamp"):
        AslRecording(asl_agent(folder))


def test_the_robots_extrinsics_survive_bit_by_bit(folder: Path) -> None:
    assert AslRecording(asl_agent(folder)).camera.T_body_cam.tobytes() == T_BODY_CAM.tobytes()


def test_the_euroc_scenario_plays_recordings_where_it_says(tmp_path: Path) -> None:
    scenario = load_scenario(SCENARIOS / "euroc.yaml", {"EUROC": str(tmp_path)})
    for agent, name in zip(
        scenario.agents, ("MH_01_easy", "MH_02_easy", "MH_03_medium"), strict=True
    ):
        assert isinstance(agent, AslAgent)
        write_asl(tmp_path / name, RoomRobot(num_frames=2))
        recording = AslRecording(agent)
        assert len(recording.frames) == 2
        assert recording.groundtruth is not None
