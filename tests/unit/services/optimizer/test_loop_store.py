"""The store over a real file: what was acked is there after a crash, once."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from covinz import codec
from covinz.durable import DurableFileError
from covinz.types import Correction
from services.optimizer.loop_store import LoopStore, StoreUnavailable
from services.optimizer.optimisation import Fault
from tests.fleets import keyframe, make_fleet


def payloads(count: int) -> list[tuple[str, bytes]]:
    loops = make_fleet(length=20, loops_per_pair=count).loops[:count]
    return [(loop.job_id, codec.encode(loop)) for loop in loops]


def correction(agent: str, revision: int) -> Correction:
    return Correction(keyframe(agent, 0, 0).id, "0" * 26, revision, np.eye(4), False, 1)


def encoded(*corrections: Correction) -> dict[str, bytes]:
    return {each.keyframe.agent: codec.encode(each) for each in corrections}


def crashed_copy(store: LoopStore, folder: Path) -> Path:
    """What another process finds when this one dies now: file and WAL, without a checkpoint."""
    source = folder / "optimizer.sqlite"
    copy = folder / "copy.sqlite"
    for suffix in ("", "-wal"):
        shutil.copy(f"{source}{suffix}", f"{copy}{suffix}")
    return copy


def test_what_was_stored_survives_a_crash_bit_by_bit(tmp_path: Path) -> None:
    store = LoopStore(tmp_path / "optimizer.sqlite")
    loops = payloads(20)
    assert store.add(loops) == [True] * 20
    store.publish(3, encoded(correction("a", 3)))
    again = LoopStore(crashed_copy(store, tmp_path))
    assert [codec.encode(loop) for loop in again.loops()] == [p for _, p in sorted(loops)]
    assert again.revision == 3
    assert [c.map_revision for c in again.corrections()] == [3]
    store.close()
    again.close()


def test_a_job_id_is_stored_once(tmp_path: Path) -> None:
    store = LoopStore(tmp_path / "optimizer.sqlite")
    one, two, three = payloads(3)
    assert store.add([one, two, one]) == [True, True, False]
    assert store.add([two, three]) == [False, True]
    assert len(store.loops()) == 3
    store.close()


def test_commits_are_synchronous(tmp_path: Path) -> None:
    store = LoopStore(tmp_path / "optimizer.sqlite")
    assert store._file.db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert store._file.db.execute("PRAGMA synchronous").fetchone() == (2,)
    store.close()


def test_a_full_disk_stores_nothing_and_says_so(tmp_path: Path) -> None:
    store = LoopStore(tmp_path / "optimizer.sqlite")
    (pages,) = store._file.db.execute("PRAGMA page_count").fetchone()
    store._file.db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(StoreUnavailable, match="full"):
        store.add(payloads(50))
    assert store.loops() == []
    store._file.db.execute("PRAGMA max_page_count = 100000")
    assert store.add(payloads(50)) == [True] * 50
    store.close()


def test_a_faulty_loop_is_left_out_and_its_reason_kept(tmp_path: Path) -> None:
    store = LoopStore(tmp_path / "optimizer.sqlite")
    (bad, payload), good = payloads(2)
    store.add([(bad, payload), good])
    store.mark([Fault(bad, "it makes no sense")])
    assert [loop.job_id for loop in store.loops()] == [good[0]]
    assert store.faults() == {bad: "it makes no sense"}
    assert store.add([(bad, payload)]) == [False]
    store.close()


def test_another_log_forgets_all_but_the_revision(tmp_path: Path) -> None:
    store = LoopStore(tmp_path / "optimizer.sqlite")
    assert store.log_id == ""
    store.begin_log("A")
    store.add(payloads(2))
    store.publish(8, encoded(correction("a", 8)))
    store.begin_log("B")
    assert store.loops() == []
    assert store.corrections() == []
    assert (store.log_id, store.revision) == ("B", 8)
    store.close()


def test_the_last_correction_of_each_agent_is_kept(tmp_path: Path) -> None:
    store = LoopStore(tmp_path / "optimizer.sqlite")
    store.publish(1, encoded(correction("a", 1), correction("b", 1)))
    store.publish(2, encoded(correction("b", 2)))
    assert [(c.keyframe.agent, c.map_revision) for c in store.corrections()] == [("a", 1), ("b", 2)]
    store.close()


def test_a_store_has_one_owner(tmp_path: Path) -> None:
    store = LoopStore(tmp_path / "optimizer.sqlite")
    with pytest.raises(DurableFileError, match="in use"):
        LoopStore(tmp_path / "optimizer.sqlite")
    store.close()
