"""Caps on size and age over a real log, with a clock in the hands of the test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from covinz.config import IngestConfig
from services.ingest.admission import AdmittedUpload, admit_upload
from services.ingest.keyframe_log import KeyframeLog
from services.ingest.retention import CHECK_S, DAY_S, STEP_ENTRIES, Retention
from tests.uploads import CAMERA, message

LARGE = 1000  # features, 36 kB


def keyframes(*seqs: int, num_features: int = 3) -> list[AdmittedUpload]:
    found = []
    for seq in seqs:
        payload = message(seq, num_features=num_features)
        answer = admit_upload("a0", payload, {CAMERA.hash: CAMERA}, IngestConfig())
        assert isinstance(answer, AdmittedUpload)
        found.append(answer)
    return found


class Bench:
    """A log and its retention."""

    def __init__(self, path: Path, config: IngestConfig) -> None:
        self.path = path
        self.now_s = 1000.0
        self.config = config
        self.log = KeyframeLog(path)
        self._start()

    def _start(self) -> None:
        self.retention = Retention(
            self.log.retained, lambda: self.log.head, self.config, lambda: self.now_s
        )

    def restart(self, days_off: float) -> None:
        self.log.close()
        self.now_s += days_off * DAY_S
        self.log = KeyframeLog(self.path)
        self._start()

    def run(self, days: float) -> None:
        """Let time pass, and do all that is to be done."""
        end_s = self.now_s + days * DAY_S
        while self.now_s < end_s:
            self.now_s = min(end_s, self.now_s + CHECK_S)
            while self.retention.patience_s() == 0.0:
                self.retention.step()

    @property
    def features_from(self) -> int:
        return self.log.retained.features_from


@pytest.fixture
def benches(tmp_path: Path) -> Iterator[list[Bench]]:
    made: list[Bench] = []
    yield made
    for bench in made:
        bench.log.close()


def bench_of(benches: list[Bench], path: Path, config: IngestConfig) -> Bench:
    benches.append(Bench(path / "ingest.sqlite", config))
    return benches[-1]


def test_without_caps_there_is_nothing_to_do(tmp_path: Path, benches: list[Bench]) -> None:
    bench = bench_of(benches, tmp_path, IngestConfig())
    bench.log.append(keyframes(*range(10)))
    bench.now_s += 1000 * DAY_S
    assert bench.retention.patience_s() is None
    bench.retention.step()
    assert bench.features_from == 0


def test_a_log_stays_below_its_size_and_the_file_shrinks(
    tmp_path: Path, benches: list[Bench]
) -> None:
    cap = 4 * 1024 * 1024
    bench = bench_of(benches, tmp_path, IngestConfig())
    for first in range(0, 400, 50):
        bench.log.append(keyframes(*range(first, first + 50), num_features=LARGE))
    size_before = bench.log.retained.used_bytes
    assert size_before > 14 * 1024 * 1024
    bench.log.close()
    assert bench.path.stat().st_size > 14 * 1024 * 1024

    capped = Bench(bench.path, IngestConfig(max_log_bytes=cap))
    benches.append(capped)
    steps = 0
    while capped.log.retained.used_bytes > cap or capped.log.retained.free_pages > 1024:
        capped.retention.check_now()
        capped.retention.step()
        steps += 1
    assert capped.features_from % STEP_ENTRIES == 0
    assert 300 > 400 - capped.features_from > 0
    assert steps > capped.features_from / STEP_ENTRIES
    for seq in range(400, 500):
        capped.log.append(keyframes(seq, num_features=LARGE))
        capped.retention.check_now()
        capped.retention.step()
        assert capped.log.retained.used_bytes < cap + 2 * 40_000
    assert capped.log.head == 500
    capped.log.close()
    assert bench.path.stat().st_size < cap + 5 * 1024 * 1024


def test_poses_are_never_dropped(
    tmp_path: Path, benches: list[Bench], caplog: pytest.LogCaptureFixture
) -> None:
    bench = bench_of(benches, tmp_path, IngestConfig(max_log_bytes=1))
    bench.log.append(keyframes(*range(100)))
    for _ in range(10):
        bench.retention.check_now()
        bench.retention.step()
    assert (bench.features_from, bench.log.head) == (100, 100)
    assert caplog.text.count("the poses alone take more") == 1


def test_features_grow_old_while_ingest_runs(tmp_path: Path, benches: list[Bench]) -> None:
    bench = bench_of(benches, tmp_path, IngestConfig(max_features_days=10))
    bench.log.append(keyframes(0, 1))
    bench.run(days=6)
    bench.log.append(keyframes(2, 3))
    bench.run(days=5)
    assert bench.features_from == 2
    bench.run(days=6)
    assert bench.features_from == 4


def test_time_off_and_jumps_of_the_clock_drop_nothing(tmp_path: Path, benches: list[Bench]) -> None:
    """The clock is monotonic while ingest runs, and another one after each start."""
    bench = bench_of(benches, tmp_path, IngestConfig(max_features_days=10))
    bench.log.append(keyframes(0, 1))
    bench.run(days=6)
    for jump_days in (400, -3000):
        bench.restart(days_off=jump_days)
        bench.run(days=1)
        assert bench.features_from == 0
    bench.run(days=3)
    assert bench.features_from == 2
