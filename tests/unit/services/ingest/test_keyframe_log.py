"""The log and its readers over a real file: gapless numbers, exactly once, all or nothing."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from covinz import codec
from covinz.config import IngestConfig
from covinz.durable import DurableFileError
from covinz.types import (
    Camera,
    Duplicate,
    Gap,
    Keyframe,
    KeyframeId,
    LogPage,
    LogRange,
    LogView,
    Rejected,
    Stored,
)
from services.ingest.admission import (
    AdmittedCamera,
    AdmittedUpload,
    admit_camera,
    admit_upload,
)
from services.ingest.keyframe_log import AgentTotals, KeyframeLog, LogUnavailable
from services.ingest.log_reader import LogReader, OtherHistory
from tests.uploads import CAMERA, SESSION, keyframe, message


def admitted(payload: bytes, agent: str = "a0") -> AdmittedUpload:
    answer = admit_upload(agent, payload, {CAMERA.hash: CAMERA}, IngestConfig())
    assert isinstance(answer, AdmittedUpload)
    return answer


def camera(agent: str = "a0") -> AdmittedCamera:
    answer = admit_camera(agent, codec.encode(CAMERA))
    assert isinstance(answer, AdmittedCamera)
    return answer


def keyframes(*seqs: int) -> list[AdmittedUpload]:
    return [admitted(message(seq)) for seq in seqs]


def page_of(reader: LogReader, start: int, view: LogView = LogView.FULL) -> LogPage:
    return codec.decode(reader.page(LogRange(start, view)), LogPage)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ingest.sqlite"


@pytest.fixture
def log(path: Path) -> Iterator[KeyframeLog]:
    log = KeyframeLog(path, busy_timeout_s=0.05)
    yield log
    log.close()


@pytest.fixture
def reader(log: KeyframeLog, path: Path) -> Iterator[LogReader]:
    reader = LogReader(path, page_bytes=1024 * 1024)
    yield reader
    reader.close()


def test_numbers_count_from_zero_over_batches_and_restarts(path: Path) -> None:
    log = KeyframeLog(path)
    log_id = log.log_id
    assert log.append([camera(), *keyframes(4, 2)]) == [Stored()] * 3
    assert log.append([admitted(codec.encode(Gap("a0", SESSION, 0, 1, "spool full")))]) == [
        Stored()
    ]
    log.close()

    log = KeyframeLog(path)
    assert (log.log_id, log.head) == (log_id, 3)
    assert log.cameras.keys() == {CAMERA.hash}
    assert log.append(keyframes(3)) == [Stored()]
    reader = LogReader(path, page_bytes=1024 * 1024)
    page = page_of(reader, 0)
    assert [entry.log_index for entry in page.entries] == [0, 1, 2, 3]
    items = [entry.item for entry in page.entries]
    assert [item.id.seq if isinstance(item, Keyframe) else item for item in items] == [
        4,
        2,
        Gap("a0", SESSION, 0, 1, "spool full"),
        3,
    ]
    reader.close()
    log.close()


def test_another_file_is_another_history(tmp_path: Path, log: KeyframeLog) -> None:
    other = KeyframeLog(tmp_path / "other.sqlite")
    assert other.log_id != log.log_id
    other.close()


def test_the_same_again_is_a_duplicate(log: KeyframeLog) -> None:
    gap = admitted(codec.encode(Gap("a0", SESSION, 5, 6, "spool full")))
    assert log.append([*keyframes(0, 1, 0), gap]) == [Stored(), Stored(), Duplicate(), Stored()]
    assert log.append([*keyframes(1, 2), gap]) == [Duplicate(), Stored(), Duplicate()]
    assert log.append([camera(), camera("a1")]) == [Stored(), Duplicate()]
    assert log.head == 4


def test_other_content_under_the_same_id_is_a_conflict(log: KeyframeLog) -> None:
    log.append(keyframes(0))
    other = admitted(message(0, num_features=4))
    (answer,) = log.append([other])
    assert isinstance(answer, Rejected)
    assert answer.code == "conflict"
    assert log.head == 1


def test_agents_do_not_collide(log: KeyframeLog) -> None:
    batch = [admitted(message(0)), admitted(message(0, agent="a1"), "a1")]
    assert log.append(batch) == [Stored(), Stored()]
    size = {agent: len(message(0, agent=agent)) for agent in ("a0", "a1")}
    assert log.totals() == {agent: AgentTotals(1, size[agent], 0, 0) for agent in ("a0", "a1")}


def test_totals_count_what_agents_dropped(log: KeyframeLog) -> None:
    gap = codec.encode(Gap("a0", SESSION, 3, 9, "spool full"))
    log.append([*keyframes(0, 1), admitted(gap), camera()])
    size = len(message(0)) + len(message(1)) + len(gap)
    assert log.totals() == {"a0": AgentTotals(2, size, 1, 7)}
    assert log.camera_counts() == {"a0": 1}


def test_pages_end_at_their_size_and_continue(log: KeyframeLog, path: Path) -> None:
    log.append(keyframes(*range(10)))
    reader = LogReader(path, page_bytes=3 * len(message(0)))
    seen: list[int] = []
    while True:
        page = page_of(reader, len(seen))
        assert page.head == 10
        if not page.entries:
            break
        assert len(page.entries) <= 3
        seen += [entry.log_index for entry in page.entries]
    assert seen == list(range(10))
    reader.close()


def test_a_page_holds_an_entry_that_is_larger_than_a_page(log: KeyframeLog, path: Path) -> None:
    log.append(keyframes(0, 1))
    reader = LogReader(path, page_bytes=1)
    assert [entry.log_index for entry in page_of(reader, 1).entries] == [1]
    reader.close()


def test_views(log: KeyframeLog, reader: LogReader) -> None:
    log.append(keyframes(3))
    full = page_of(reader, 0).entries[0].item
    pose = page_of(reader, 0, LogView.POSE).entries[0].item
    assert isinstance(full, Keyframe)
    assert isinstance(pose, Keyframe)
    assert full.features is not None
    sent = keyframe(3).features
    assert sent is not None
    np.testing.assert_array_equal(full.features.descriptors, sent.descriptors)
    np.testing.assert_array_equal(full.features.keypoints_px, sent.keypoints_px)
    assert pose.features is None
    np.testing.assert_array_equal(pose.T_odom_body, full.T_odom_body)


def test_beyond_the_head_there_is_nothing(log: KeyframeLog, reader: LogReader) -> None:
    log.append(keyframes(0))
    for start in (1, 2, 2**63 - 1):
        page = page_of(reader, start)
        assert (page.log_id, page.head, page.entries) == (log.log_id, 1, ())


def test_single_keyframes_and_cameras_come_as_they_were_sent(
    log: KeyframeLog, reader: LogReader
) -> None:
    log.append([camera(), *keyframes(0)])
    assert reader.keyframe(keyframe(0).id) == message(0)
    assert reader.camera(CAMERA.hash) == codec.encode(CAMERA)
    assert reader.keyframe(keyframe(1).id) is None
    assert reader.keyframe(KeyframeId("a0", SESSION, 10**30)) is None
    assert reader.camera("0" * 16) is None


def test_a_gap_is_no_keyframe(log: KeyframeLog, reader: LogReader) -> None:
    log.append([admitted(codec.encode(Gap("a0", SESSION, 0, 0, "spool full")))])
    assert reader.keyframe(keyframe(0).id) is None
    assert log.append(keyframes(0)) == [Stored()]
    assert reader.keyframe(keyframe(0).id) == message(0)


def test_a_locked_file_stores_nothing_and_recovers(log: KeyframeLog, path: Path) -> None:
    log.append(keyframes(0))
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(LogUnavailable, match="locked"):
        log.append([camera(), *keyframes(1)])
    assert log.head == 1
    assert not log.cameras
    other.execute("ROLLBACK")
    other.close()
    assert log.append([camera(), *keyframes(1)]) == [Stored(), Stored()]
    assert log.head == 2


def test_a_full_disk_stores_nothing_of_the_batch_and_recovers(path: Path) -> None:
    log = KeyframeLog(path)
    log.append(keyframes(0))
    db = log._file.db
    (pages,) = db.execute("PRAGMA page_count").fetchone()
    db.execute(f"PRAGMA max_page_count = {pages + 4}")
    big = [admitted(message(seq, num_features=200)) for seq in range(1, 9)]
    with pytest.raises(LogUnavailable, match="full"):
        log.append(big)
    assert log.head == 1
    db.execute("PRAGMA max_page_count = 1000000")
    assert log.append(big) == [Stored()] * 8
    assert log.head == 9
    log.close()


def test_a_damaged_file_is_refused(path: Path) -> None:
    log = KeyframeLog(path)
    log.append(keyframes(*range(20)))
    log.close()
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\x55" * (size - 4096))
    with pytest.raises(DurableFileError, match="damaged"):
        KeyframeLog(path)
    with pytest.raises(DurableFileError, match="damaged"):  # and not: in use
        KeyframeLog(path)


def test_readers_do_not_delay_commits(log: KeyframeLog, path: Path) -> None:
    log.append(keyframes(*range(5)))
    slow = sqlite3.connect(f"file:{path}?mode=ro", uri=True, isolation_level=None)
    slow.execute("BEGIN")
    assert slow.execute("SELECT COUNT(*) FROM entry").fetchone() == (5,)
    assert log.append(keyframes(5)) == [Stored()]
    assert slow.execute("SELECT COUNT(*) FROM entry").fetchone() == (5,)
    slow.execute("ROLLBACK")
    assert slow.execute("SELECT COUNT(*) FROM entry").fetchone() == (6,)
    slow.close()


def test_cameras_of_other_models_stay_apart(log: KeyframeLog) -> None:
    wide = Camera("PINHOLE", 640, 480, np.array([300.0, 300.0, 319.5, 239.5]), np.eye(4))
    answer = admit_camera("a0", codec.encode(wide))
    assert isinstance(answer, AdmittedCamera)
    assert log.append([camera(), answer]) == [Stored(), Stored()]
    np.testing.assert_array_equal(log.cameras[wide.hash].params, wide.params)


# --- history --------------------------------------------------------------------------------


def follow(reader: LogReader, start: int, like: LogPage) -> bytes:
    return reader.page(LogRange(start, LogView.POSE, like.log_id, like.chain))


def test_equal_logs_have_equal_chains_whatever_the_pages(tmp_path: Path) -> None:
    chains = []
    for batches in ([[0, 1, 2, 3]], [[0], [1, 2], [3]]):
        log = KeyframeLog(tmp_path / f"{len(batches)}.sqlite")
        for seqs in batches:
            log.append(keyframes(*seqs))
        log.close()
        log = KeyframeLog(tmp_path / f"{len(batches)}.sqlite")
        log.append(keyframes(4))
        for page_bytes in (1, 1024 * 1024):
            reader = LogReader(tmp_path / f"{len(batches)}.sqlite", page_bytes)
            chain, start = "", 0
            while start < 5:
                page = page_of(reader, start)
                chain, start = page.chain, start + len(page.entries)
            assert page_of(reader, 5).chain == chain
            assert page_of(reader, 6).chain == ""
            chains.append(chain)
            reader.close()
        log.close()
    assert len(set(chains)) == 1


def test_who_followed_an_older_or_another_history_is_told(
    log: KeyframeLog, path: Path, tmp_path: Path
) -> None:
    log.append(keyframes(0, 1))
    backup = tmp_path / "backup.sqlite"
    with sqlite3.connect(backup) as copy:
        sqlite3.connect(path).backup(copy)
    copy.close()
    log.append(keyframes(2))
    reader = LogReader(path, page_bytes=1024 * 1024)
    seen = page_of(reader, 0)
    reader.close()

    restored = KeyframeLog(backup)
    reader = LogReader(backup, page_bytes=1024 * 1024)
    assert restored.log_id == log.log_id
    with pytest.raises(OtherHistory, match=log.log_id):
        follow(reader, 3, seen)
    restored.append(keyframes(5, 6))
    with pytest.raises(OtherHistory, match=log.log_id):
        follow(reader, 3, seen)
    same = page_of(LogReader(path, page_bytes=1), 0)
    assert follow(reader, 1, same)  # so far both are the same

    new = restored.begin_history()
    assert new != log.log_id
    page = codec.decode(follow(reader, 3, seen), LogPage)
    assert (page.log_id, page.head) == (new, 4)
    reader.close()
    restored.close()
    assert KeyframeLog(backup).log_id == new


def test_a_file_of_format_1_is_upgraded(path: Path) -> None:
    log = KeyframeLog(path)
    log.append([camera(), *keyframes(0, 1, 2)])
    chain = page_of(LogReader(path, 1024 * 1024), 0).chain
    log.close()
    with sqlite3.connect(path) as db:
        for table in ("chain", "retention", "age"):
            db.execute(f"DROP TABLE {table}")
        db.execute("PRAGMA user_version = 1")
    db.close()
    log = KeyframeLog(path)
    assert log.append(keyframes(0, 3)) == [Duplicate(), Stored()]
    page = page_of(LogReader(path, len(message(0))), 2)
    assert page.chain == chain
    log.close()


# --- features that are dropped or damaged ---------------------------------------------------


def test_without_features_the_poses_stay_and_the_history_is_the_same(
    log: KeyframeLog, reader: LogReader
) -> None:
    gap = admitted(codec.encode(Gap("a0", SESSION, 90, 91, "spool full")))
    log.append([camera(), *keyframes(0, 1), gap, *keyframes(2)])
    before, poses = page_of(reader, 0), page_of(reader, 0, LogView.POSE)
    log.retained.drop_features(3)
    after = page_of(reader, 0)
    assert after.chain == before.chain
    assert [entry.log_index for entry in after.entries] == [0, 1, 2, 3]
    features = [
        entry.item.features is not None
        for entry in after.entries
        if isinstance(entry.item, Keyframe)
    ]
    assert features == [False, False, True]
    assert reader.page(LogRange(0, LogView.POSE)) == codec.encode(poses)
    assert reader.keyframe(keyframe(0).id) == codec.encode(codec.without_features(keyframe(0)))
    assert log.append(keyframes(0, 2)) == [Duplicate(), Duplicate()]
    assert reader.camera(CAMERA.hash) is not None


def test_damaged_features_are_not_handed_out(
    log: KeyframeLog, reader: LogReader, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    log.append(keyframes(0, 1))
    with sqlite3.connect(path) as db:
        db.execute("UPDATE entry SET payload = zeroblob(length(payload)) WHERE log_index = 0")
    db.close()
    for _ in range(2):
        items = [entry.item for entry in page_of(reader, 0).entries]
        assert [isinstance(kf, Keyframe) and kf.features is not None for kf in items] == [
            False,
            True,
        ]
    assert caplog.text.count("the features of entry 0 are lost") == 1
