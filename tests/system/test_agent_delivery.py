"""Nothing that `send` returned for is lost: kill -9 of ingest, of the robot, of the router."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from covinz import codec, frames, keyexprs
from covinz.agent import Agent
from covinz.bus import ZenohBus
from covinz.config import BusConfig
from covinz.types import Correction, Keyframe, KeyframeId, LogHead
from tests.processes import CHECKOUT, PATIENCE_S, Processes
from tests.uploads import content


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Processes]:
    with Processes(tmp_path) as server:
        yield server


class Head:
    """Follows the head of the log."""

    def __init__(self, server: Processes) -> None:
        self._changed = threading.Condition()
        self._head = 0
        server.bus.subscribe(keyexprs.LOG_HEAD, self._on_head)

    def wait_for(self, head: int) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: self._head >= head, PATIENCE_S), self._head

    def _on_head(self, _: str, payload: bytes) -> None:
        with self._changed:
            self._head = codec.decode(payload, LogHead).head
            self._changed.notify_all()


def logged(server: Processes) -> list[KeyframeId]:
    """Ids of the keyframes in the log, in its order; the numbers are gapless."""
    entries = server.log_entries()
    assert [entry.log_index for entry in entries] == list(range(len(entries)))
    keyframes = [entry.item for entry in entries if isinstance(entry.item, Keyframe)]
    assert len(keyframes) == len(entries)
    return [keyframe.id for keyframe in keyframes]


def robot(server: Processes, spool: Path, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "tests.system.robot", server.endpoint, str(spool), str(count)],
        cwd=CHECKOUT,
        stdout=subprocess.PIPE,
        text=True,
    )


def read(process: subprocess.Popen[str], count: int) -> list[str]:
    assert process.stdout is not None
    return [process.stdout.readline().strip() for _ in range(count)]


def kill(process: subprocess.Popen[str]) -> list[str]:
    """End the robot at once; returns what it had still said."""
    process.kill()
    rest, _ = process.communicate()
    return [line for line in rest.splitlines() if "/" in line]


def test_killing_ingest_while_an_agent_sends(server: Processes, tmp_path: Path) -> None:
    server.start("router", "ingest")
    head = Head(server)
    with Agent("a0", server.endpoint, tmp_path / "a0.spool") as agent:
        sent = [agent.send(content(seq, num_features=200)) for seq in range(100)]
        head.wait_for(20)
        server.kill("ingest")
        sent += [agent.send(content(seq, num_features=200)) for seq in range(100, 200)]
        assert agent.pending >= 100
        server.start("ingest")
        assert agent.wait_delivered(PATIENCE_S)
        assert agent.pending == 0
    assert sorted(logged(server)) == sorted(sent)


def test_killing_ingest_again_and_again(server: Processes, tmp_path: Path) -> None:
    server.start("router", "ingest")
    head = Head(server)
    with Agent("a0", server.endpoint, tmp_path / "a0.spool") as agent:
        sent: list[KeyframeId] = []
        for round_ in range(1, 4):
            sent += [agent.send(content(len(sent) + i, num_features=200)) for i in range(40)]
            head.wait_for(25 * round_)
            server.kill("ingest")
            server.start("ingest")
        assert agent.wait_delivered(PATIENCE_S)
    assert sorted(logged(server)) == sorted(sent)


@pytest.mark.parametrize("is_server_up", [True, False])
def test_killing_the_robot_while_it_sends(
    server: Processes, tmp_path: Path, is_server_up: bool
) -> None:
    if is_server_up:
        server.start("router", "ingest")
    first = robot(server, tmp_path / "a0.spool", 10_000)
    safe = read(first, 60)
    safe += kill(first)
    if not is_server_up:
        server.start("router", "ingest")

    second = robot(server, tmp_path / "a0.spool", 10)
    safe += read(second, 10)
    assert read(second, 2) == ["sent", "delivered"]
    second.communicate()

    in_log = [str(keyframe) for keyframe in logged(server)]
    assert len(set(in_log)) == len(in_log)
    # One keyframe may be durable whose id the robot had not said yet.
    assert set(safe) <= set(in_log)
    assert len(in_log) <= len(safe) + 1
    sessions = {keyframe.session for keyframe in logged(server)}
    assert len(sessions) == 2
    for session in sessions:
        seqs = sorted(k.seq for k in logged(server) if k.session == session)
        assert seqs == list(range(len(seqs)))


def test_killing_the_router_while_an_agent_sends(server: Processes, tmp_path: Path) -> None:
    server.start("router", "ingest")
    head = Head(server)
    with Agent("a0", server.endpoint, tmp_path / "a0.spool") as agent:
        sent = [agent.send(content(seq, num_features=200)) for seq in range(100)]
        head.wait_for(10)
        server.kill("router")
        sent += [agent.send(content(seq, num_features=200)) for seq in range(100, 150)]
        server.start("router")
        assert agent.wait_delivered(PATIENCE_S)
        server.wait_ready("ingest")
    assert sorted(logged(server)) == sorted(sent)


def test_an_agent_that_starts_before_the_server(server: Processes, tmp_path: Path) -> None:
    with Agent("a0", server.endpoint, tmp_path / "a0.spool") as agent:
        sent = [agent.send(content(seq)) for seq in range(20)]
        assert not agent.wait_delivered(0.0)
        server.start("router", "ingest")
        assert agent.wait_delivered(PATIENCE_S)
    assert sorted(logged(server)) == sent


def test_corrections_reach_the_agent_also_those_from_before_it_came(
    server: Processes, tmp_path: Path
) -> None:
    server.start("router")
    optimizer = ZenohBus.open(BusConfig(endpoint=server.endpoint))
    session = "01JD0000000000000000000000"

    def correction(revision: int) -> Correction:
        T_map_odom = frames.transform(frames.so3_exp([0.0, 0.0, 0.1]), [revision, 0.0, 0.0])
        keyframe = KeyframeId("a0", session, 0)
        return Correction(keyframe, session, revision, T_map_odom, False, revision)

    optimizer.answer(
        keyexprs.agent_correction("a0"),
        lambda query: query.reply(codec.encode(correction(1))),
    )
    came = threading.Condition()
    revisions: list[int] = []

    def on_correction(news: Correction) -> None:
        with came:
            revisions.append(news.map_revision)
            came.notify_all()

    with Agent(
        "a0",
        server.endpoint,
        tmp_path / "a0.spool",
        session=session,
        on_correction=on_correction,
    ) as agent:
        with came:
            assert came.wait_for(lambda: revisions == [1], PATIENCE_S)
            optimizer.put(keyexprs.agent_correction("a0"), codec.encode(correction(2)))
            assert came.wait_for(lambda: revisions == [1, 2], PATIENCE_S)
        T_map_odom = agent.T_map_odom
        assert T_map_odom is not None
        assert T_map_odom[0, 3] == 2.0
    optimizer.close()
