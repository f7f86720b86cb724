"""A robot whose process dies, whose disk is full, whose server hangs, over real Zenoh."""

from __future__ import annotations

import random
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from covinz.agent import Agent
from covinz.config import AgentConfig, Config
from covinz.types import Keyframe, KeyframeId
from tests.processes import CHECKOUT, PATIENCE_S, Processes
from tests.uploads import content

ROUNDS = 12
# Pauses so long that a test fails if they are not cut short.
SLOW = Config(agent=AgentConfig(min_backoff_s=600.0, max_backoff_s=600.0))


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Processes]:
    with Processes(tmp_path) as server:
        yield server


class Robot:
    """`tests.system.robot` as a process."""

    def __init__(self, server: Processes, spool: Path, count: int, plan: str = "deliver") -> None:
        arguments = [server.endpoint, str(spool), str(count), plan]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.system.robot", *arguments],
            cwd=CHECKOUT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def said(self, count: int) -> list[str]:
        """The next lines."""
        assert self.process.stdout is not None
        return [self.process.stdout.readline().strip() for _ in range(count)]

    def said_until(self, word: str) -> list[str]:
        """All lines before the one that is `word`."""
        assert self.process.stdout is not None
        lines: list[str] = []
        for line in self.process.stdout:
            if line.strip() == word:
                return lines
            lines.append(line.strip())
        raise AssertionError(f"it ended without {word!r}: {lines[-3:]}")

    def kill(self) -> list[str]:
        """End it like a power cut; the ids that it had still said."""
        self.process.kill()
        rest, _ = self.process.communicate()
        return [line for line in rest.splitlines() if line.count("/") == 2]

    def tell(self) -> None:
        """One line for it to read."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()


def logged(server: Processes) -> list[KeyframeId]:
    items = [entry.item for entry in server.log_entries()]
    return [item.id for item in items if isinstance(item, Keyframe)]


def test_killing_the_robot_again_and_again(server: Processes, tmp_path: Path) -> None:
    spool, draw = tmp_path / "a0.spool", random.Random(5)
    server.start("router", "ingest")
    safe: list[str] = []
    for round_ in range(ROUNDS):
        victim = Robot(server, spool, 10_000)
        safe += victim.said(draw.randint(1, 30))
        safe += victim.kill()
        if round_ % 4 == 1:
            server.kill("ingest")
        elif round_ % 4 == 3:
            server.start("ingest")
    last = Robot(server, spool, 5)
    safe += last.said_until("sent")
    assert last.said(1) == ["delivered"]
    last.process.communicate()

    in_log = [str(keyframe) for keyframe in logged(server)]
    assert len(set(in_log)) == len(in_log)
    assert set(safe) <= set(in_log)
    # Of each run one may be on the disk that it had not said yet.
    assert len(in_log) <= len(safe) + ROUNDS
    seqs = defaultdict(list)
    for keyframe in logged(server):
        seqs[keyframe.session].append(keyframe.seq)
    assert all(sorted(of) == list(range(len(of))) for of in seqs.values())
    assert len(seqs) == ROUNDS + 1


def test_a_robot_whose_disk_is_full(server: Processes, tmp_path: Path) -> None:
    robot = Robot(server, tmp_path / "a0.spool", 20, "full")
    before = robot.said_until("sent")
    assert robot.said(20) == ["refused"] * 20
    # What is on the disk is delivered all the same, and known to be.
    server.start("router", "ingest")
    assert robot.said(1) == ["empty"]
    assert sorted(str(keyframe) for keyframe in logged(server)) == sorted(before)
    robot.tell()
    after = robot.said_until("delivered")
    assert len(after) == 20
    assert sorted(map(str, logged(server))) == sorted(before + after)
    assert sorted(keyframe.seq for keyframe in logged(server)) == list(range(40))
    robot.process.communicate()


@pytest.mark.parametrize("hanging", ["router", "ingest"])
def test_sending_and_leaving_while_the_server_hangs(
    server: Processes, tmp_path: Path, hanging: str
) -> None:
    server.start("router", "ingest")
    with Agent("a0", server.endpoint, tmp_path / "other.spool") as agent:
        sent = [agent.send(content(0))]
        assert agent.wait_delivered(PATIENCE_S)
        server.freeze(hanging)
        sent += [agent.send(content(seq, num_features=1000)) for seq in range(1, 100)]
        assert agent.pending >= 95
    # It has ended by now, though nobody answers; what is left goes with the next run.
    server.thaw(hanging)
    server.wait_ready("ingest")
    with Agent("a0", server.endpoint, tmp_path / "other.spool") as agent:
        assert agent.wait_delivered(PATIENCE_S)
    assert sorted(logged(server)) == sent


def test_a_program_ends_while_the_router_hangs(server: Processes, tmp_path: Path) -> None:
    server.start("router", "ingest")
    robot = Robot(server, tmp_path / "a0.spool", 50, "leave")
    robot.said(1)
    server.freeze("router")
    robot.said_until("sent")
    assert robot.process.wait(PATIENCE_S) == 0
    robot.process.communicate()
    server.thaw("router")


def test_a_pause_ends_when_the_server_is_back(server: Processes, tmp_path: Path) -> None:
    with Agent("a0", server.endpoint, tmp_path / "a0.spool", SLOW) as agent:
        agent.send(content(0))
        assert not agent.wait_delivered(0.5)  # the first attempt has failed
        server.start("router", "ingest")
        assert agent.wait_delivered(PATIENCE_S)
        for name in ("ingest", "router"):
            server.kill(name)
            agent.send(content(1))
            assert not agent.wait_delivered(0.5)
            server.start(name)
            server.wait_ready("ingest")
            assert agent.wait_delivered(PATIENCE_S)
    assert len(logged(server)) == 3
