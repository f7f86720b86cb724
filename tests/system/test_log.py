"""The keyframe log between real processes: a follower misses nothing when ingest is killed."""

from __future__ import annotations

import queue
import subprocess
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from covinz import codec, keyexprs
from covinz.bus import ZenohBus
from covinz.log_follower import LogFollower, LogReset
from covinz.types import Gap, LogEntry, LogPage, LogView, Stored

WAIT_S = 30.0
SESSION = "01J9Z0000000000000000000CC"


def gap(i: int) -> Gap:
    return Gap("a", SESSION, 2 * i, 2 * i, "test")


def upload(bus: ZenohBus, i: int) -> None:
    key = keyexprs.agent_keyframe("a")
    there: queue.Queue[bool] = queue.Queue()
    with closing(bus.watch_answered(key, there.put)):
        while not (replies := bus.ask(key, codec.encode(gap(i)))):
            there.get(timeout=WAIT_S)
    assert [codec.decode_upload_reply(reply) for reply in replies] == [Stored()]


def test_a_follower_misses_nothing_and_notices_another_log(
    start_service: Callable[..., subprocess.Popen[str]],
    open_bus: Callable[[], ZenohBus],
    tmp_path: Path,
) -> None:
    start_service("router")
    ingest = start_service("ingest")
    sender = open_bus()
    events: queue.Queue[LogReset | LogPage] = queue.Queue()

    def expect(*indices: int) -> None:
        for index in indices:
            if not pending:
                event = events.get(timeout=WAIT_S)
                assert isinstance(event, LogPage)
                pending.extend(event.entries)
            entry = pending.pop(0)
            assert entry.log_index == index and entry.item == gap(index)

    pending: list[LogEntry] = []
    with closing(LogFollower(open_bus(), LogView.POSE, events.put)) as follower:
        follower.start(0, "")
        for i in range(3):
            upload(sender, i)
        first = events.get(timeout=WAIT_S)
        assert isinstance(first, LogReset)
        expect(0, 1, 2)
        ingest.kill()
        ingest.wait()
        ingest = start_service("ingest")
        upload(sender, 3)
        expect(3)
        ingest.kill()
        ingest.wait()
        for file in (tmp_path / "data").glob("ingest.sqlite*"):
            file.unlink()
        start_service("ingest")
        upload(sender, 0)
        second = events.get(timeout=WAIT_S)
        assert isinstance(second, LogReset) and second.log_id != first.log_id
        expect(0)
