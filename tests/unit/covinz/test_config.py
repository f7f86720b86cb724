"""Configuration: default < file < environment, and errors that name the entry."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from covinz import config
from covinz.config import Config, ConfigError, load


def write(folder: Path, text: str) -> Path:
    path = folder / "covinz.yaml"
    path.write_text(text)
    return path


def test_no_file_is_needed() -> None:
    assert load(environ={}) == Config()


def test_paper_values_are_the_defaults() -> None:
    values = Config()
    assert values.loop_solver.min_pair_inliers == 30
    assert values.loop_solver.min_rig_inliers == 100
    assert values.optimizer.num_odometry_neighbours == 4


def test_file_overrides_defaults_and_environment_overrides_the_file(tmp_path: Path) -> None:
    path = write(tmp_path, "optimizer: {cauchy_scale: 2, max_iterations: 7}\n")
    assert load(path, {}).optimizer.cauchy_scale == 2
    both = load(path, {"COVINZ__OPTIMIZER__CAUCHY_SCALE": "3", "PATH": "/bin"})
    assert both.optimizer.cauchy_scale == 3
    assert both.optimizer.max_iterations == 7
    assert both.ingest == Config().ingest


def test_environment_reaches_nested_sections() -> None:
    name = "COVINZ__OPTIMIZER__ODOMETRY_OF__ROBOT_1__MIN_ROTATION"
    loaded = load(environ={name: "0.5", "COVINZ__LOOP_SOLVER__MATCHING__MUTUAL": "false"})
    assert loaded.optimizer.odometry_of["robot_1"].min_rotation == 0.5
    assert loaded.loop_solver.matching.mutual is False


def test_empty_file_changes_nothing(tmp_path: Path) -> None:
    assert load(write(tmp_path, "# nothing yet\n"), {}) == Config()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("optimizer: {cauchy_skale: 2}", "optimizer.cauchy_skale"),
        ("optimiser: {}", "optimiser"),
        ("optimizer: {cauchy_scale: 0}", "optimizer.cauchy_scale"),
        ("optimizer: {cauchy_scale: .nan}", "optimizer.cauchy_scale"),
        ("optimizer: {cauchy_scale: .inf}", "optimizer.cauchy_scale"),
        ("optimizer: {max_iterations: many}", "optimizer.max_iterations"),
        ("optimizer: {odometry_of: {a: {min_rotation: -1}}}", "odometry_of.a.min_rotation"),
        ("ingest: {max_batch: -3}", "ingest.max_batch"),
        ("ingest: 3", "ingest"),
        ("- a\n- b", "expected a mapping"),
        ("a: [", "cannot read"),
    ],
)
def test_bad_files_are_refused_with_the_entry(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as failure:
        load(path, {})
    assert message in str(failure.value)
    assert str(path) in str(failure.value)


def test_unreadable_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "covinz.yaml").write_bytes(b"\xff\xfe\xff")
    for path in (tmp_path / "absent.yaml", tmp_path, tmp_path / "covinz.yaml"):
        with pytest.raises(ConfigError, match="cannot read"):
            load(path, {})


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("COVINZ__OPTIMIZER__CAUCHY_SKALE", "2", "cauchy_skale"),
        ("COVINZ__OPTIMIZER__CAUCHY_SCALE", "-2", "cauchy_scale"),
        ("COVINZ__OPTIMIZER", "2", "optimizer"),
        ("COVINZ__OPTIMIZER__CAUCHY_SCALE__X", "2", "cauchy_scale"),
        ("COVINZ__OPTIMIZER__CAUCHY_SCALE", "[", "cauchy_scale"),
        ("COVINZ__", "2", "environment"),
    ],
)
def test_bad_environment_is_refused(name: str, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load(environ={name: text})


def test_section_that_is_a_value_in_the_file(tmp_path: Path) -> None:
    path = write(tmp_path, "optimizer: 3\n")
    with pytest.raises(ConfigError, match="optimizer is not a section"):
        load(path, {"COVINZ__OPTIMIZER__CAUCHY_SCALE": "2"})


def test_every_bad_entry_is_named_in_one_line(tmp_path: Path) -> None:
    path = write(tmp_path, "bus: {endpint: x}\noptimizer: {cauchy_scale: -1}\n")
    with pytest.raises(ConfigError) as failure:
        load(path, {})
    assert str(failure.value) == (
        f"{path}: bus.endpint: there is no such setting; "
        "optimizer.cauchy_scale: Input should be greater than 0"
    )


def test_environment_replaces_single_entries_of_other_values() -> None:
    values = {"optimizer": {"cauchy_scale": 1.0, "max_iterations": 7}}
    changed = config.with_environment(values, {"COVINZ__OPTIMIZER__CAUCHY_SCALE": "2", "HOME": "/"})
    assert changed == {"optimizer": {"cauchy_scale": 2, "max_iterations": 7}}
    assert values == {"optimizer": {"cauchy_scale": 1.0, "max_iterations": 7}}


def test_values_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Config().bus.endpoint = "tcp/elsewhere:1"


def test_merge_replaces_single_entries() -> None:
    base = {"a": {"x": 1, "y": 2}, "b": 3}
    assert config.merge(base, {"a": {"y": 5}, "c": 6}) == {"a": {"x": 1, "y": 5}, "b": 3, "c": 6}
    assert config.merge(base, {"a": 4}) == {"a": 4, "b": 3}
    assert base == {"a": {"x": 1, "y": 2}, "b": 3}


def test_values_in_force_are_printed(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "covinz.config"]
    environment = {"COVINZ__AGENT__WINDOW": "9"}
    printed = subprocess.run(command, env=environment, capture_output=True, check=True).stdout
    values = yaml.safe_load(printed)
    assert values["agent"]["window"] == 9
    assert Config.model_validate(values) == load(environ=environment)
