"""The optimizer process with router and ingest: maps and corrections, through kills and restarts.

Robots are real agents; the loops are sent as a loop solver would send them.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from queue import Empty, SimpleQueue

import numpy as np
import pytest

from covinz import client, codec, keyexprs
from covinz.agent import Agent
from covinz.config import OptimizerConfig
from covinz.frames import Array
from covinz.types import (
    Correction,
    Duplicate,
    Keyframe,
    KeyframeContent,
    LoopClosure,
    MapSnapshot,
    Rejected,
    RetryAfter,
    Stored,
    UploadReply,
)
from services.optimizer.optimisation import optimise
from tests.fleets import Fleet, aligned_rmse, components_of, make_fleet, session
from tests.processes import PATIENCE_S, Processes
from tests.uploads import CAMERA, features

AGENTS = ("agent0", "agent1", "agent2")
FLEET = make_fleet(seed=3, num_agents=3, length=20, loops_per_pair=6)


class Corrections:
    """Hears the corrections of all agents."""

    def __init__(self, server: Processes) -> None:
        self._server = server
        self._heard: SimpleQueue[Correction] = SimpleQueue()
        server.bus.subscribe(
            keyexprs.AGENT_CORRECTIONS,
            lambda _, payload: self._heard.put(codec.decode(payload, Correction)),
        )

    def wait_until_all_is_reflected(self) -> None:
        """Until the maps show the whole log and every loop; each step there sends a correction."""
        head = len(self._server.log_entries())
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            status = self._server.status("optimizer")
            if status.cursor == head and not status.dirty and not status.pending:
                return
            # A correction may be lost on its way.
            with contextlib.suppress(Empty):
                self._heard.get(timeout=1.0)
        raise AssertionError(f"{status}\n{self._server.log_of('optimizer')}")


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Processes]:
    with Processes(tmp_path) as server:
        server.start("router", "ingest", "place_recognition", "optimizer")
        yield server


@pytest.fixture
def agents(server: Processes, tmp_path: Path) -> Iterator[list[Agent]]:
    with ExitStack() as stack:
        yield [
            stack.enter_context(
                Agent(name, server.endpoint, tmp_path / f"{name}.spool", session=session(number))
            )
            for number, name in enumerate(AGENTS)
        ]


def upload(agents: Sequence[Agent], fleet: Fleet) -> None:
    """All keyframes; the first agent's first one is first in the log."""
    for agent, name in zip(agents, AGENTS, strict=True):
        for kf in fleet.keyframes:
            if kf.id.agent == name:
                agent.send(KeyframeContent(kf.stamp_ns, kf.T_odom_body, CAMERA, features()))
        assert agent.wait_delivered(PATIENCE_S)


def bring(server: Processes, loop: LoopClosure | bytes) -> UploadReply:
    payload = loop if isinstance(loop, bytes) else codec.encode(loop)
    while True:
        (reply,) = server.bus.ask(keyexprs.LOOP, payload)
        answer = codec.decode_upload_reply(reply)
        if not isinstance(answer, RetryAfter):
            return answer
        # It does not know yet which log there is.
        threading.Event().wait(0.05)


def only_map(server: Processes) -> MapSnapshot:
    (snapshot,) = client.snapshots(server.bus)
    return snapshot


def bits(snapshot: MapSnapshot) -> tuple[object, ...]:
    names = ("T_map_body", "T_from_to", "information", "edge_from", "edge_to", "is_loop")
    return (snapshot.keyframes, *(getattr(snapshot, name).tobytes() for name in names))


def poses_in_log_order(server: Processes, loops: Sequence[LoopClosure]) -> Array:
    """What decision 0003 says the only map is, computed here from the log and the loops."""
    keyframes = [
        (entry.log_index, entry.item)
        for entry in server.log_entries()
        if isinstance(entry.item, Keyframe)
    ]
    (component,) = components_of(keyframes, loops)
    return optimise(component, OptimizerConfig()).T_map_body


def test_three_robots_end_up_in_one_map_and_hear_of_it(
    server: Processes, agents: list[Agent]
) -> None:
    corrections = Corrections(server)
    upload(agents, FLEET)
    for loop in FLEET.loops:
        assert bring(server, loop) == Stored()
    corrections.wait_until_all_is_reflected()
    snapshot = only_map(server)
    assert snapshot.summary.map_id == session(0)
    assert [name.agent for name in snapshot.summary.segments] == list(AGENTS)
    assert (len(snapshot.keyframes), snapshot.is_loop.sum()) == (60, len(FLEET.loops))
    truth = np.array([FLEET.T_world_body[name] for name in snapshot.keyframes])
    assert aligned_rmse(snapshot.T_map_body, truth) < 0.1
    for name in AGENTS:
        (reply,) = server.bus.ask(keyexprs.agent_correction(name))
        correction = codec.decode(reply, Correction)
        assert correction.map_id == session(0)
        assert correction.map_revision == snapshot.summary.revision
        node = snapshot.keyframes.index(correction.keyframe)
        np.testing.assert_allclose(
            correction.T_map_odom @ snapshot.T_odom_body[node],
            snapshot.T_map_body[node],
            atol=1e-9,
        )


def test_a_robot_is_called_back_with_its_correction(server: Processes, tmp_path: Path) -> None:
    joined: SimpleQueue[Correction] = SimpleQueue()
    with ExitStack() as stack:
        agents = [
            stack.enter_context(
                Agent(
                    name,
                    server.endpoint,
                    tmp_path / f"{name}.spool",
                    session=session(number),
                    on_correction=joined.put if number == 2 else None,
                )
            )
            for number, name in enumerate(AGENTS)
        ]
        upload(agents, FLEET)
        first = joined.get(timeout=PATIENCE_S)
        assert first.map_id == session(2)
        np.testing.assert_array_equal(first.T_map_odom, np.eye(4))
        for loop in FLEET.loops:
            bring(server, loop)
        while (heard := joined.get(timeout=PATIENCE_S)).map_id != session(0):
            assert not heard.jumped
        assert heard.jumped
        assert agents[2].T_map_odom is not None


def test_bad_loops_get_their_typed_answer(server: Processes) -> None:
    answer = bring(server, b"noise")
    assert isinstance(answer, Rejected)
    assert answer.code == "malformed"
    assert server.status("optimizer").counters["rejected_loops"] == 1


def test_after_kill_or_loss_of_all_state_the_map_is_the_same(
    server: Processes, agents: list[Agent]
) -> None:
    corrections = Corrections(server)
    upload(agents, FLEET)
    for loop in FLEET.loops:
        bring(server, loop)
    corrections.wait_until_all_is_reflected()
    reference = only_map(server)
    np.testing.assert_allclose(
        reference.T_map_body, poses_in_log_order(server, FLEET.loops), atol=1e-9
    )

    server.kill("optimizer")
    server.start("optimizer")
    assert bring(server, FLEET.loops[0]) == Duplicate()
    corrections.wait_until_all_is_reflected()
    again = only_map(server)
    assert bits(again) == bits(reference)
    assert again.summary.revision > reference.summary.revision

    server.kill("optimizer")
    for file in server.data.glob("optimizer.sqlite*"):
        file.unlink()
    server.start("optimizer")
    for loop in reversed(FLEET.loops):
        assert bring(server, loop) == Stored()
    corrections.wait_until_all_is_reflected()
    assert bits(only_map(server)) == bits(reference)


def test_no_acked_loop_is_lost_when_the_optimizer_is_killed_again_and_again(
    server: Processes, agents: list[Agent]
) -> None:
    corrections = Corrections(server)
    acked = threading.Semaphore(0)
    to_bring = list(FLEET.loops)

    def work() -> None:
        """As a loop solver does: keep a loop until somebody says that it is durable."""
        for loop in to_bring:
            while True:
                for reply in server.bus.ask(keyexprs.LOOP, codec.encode(loop)):
                    answer = codec.decode_upload_reply(reply)
                    break
                else:
                    server.wait_ready("optimizer")
                    continue
                if answer in (Stored(), Duplicate()):
                    break
                assert isinstance(answer, RetryAfter)
            acked.release()

    worker = threading.Thread(target=work)
    worker.start()
    upload(agents, FLEET)
    for _ in range(3):
        for _ in range(8):
            assert acked.acquire(timeout=PATIENCE_S)
        server.kill("optimizer")
        server.start("optimizer")
    worker.join(PATIENCE_S)
    assert not worker.is_alive()
    corrections.wait_until_all_is_reflected()
    snapshot = only_map(server)
    assert snapshot.summary.num_loops == len(FLEET.loops)
    np.testing.assert_allclose(
        snapshot.T_map_body, poses_in_log_order(server, FLEET.loops), atol=1e-9
    )


def test_it_stops_when_asked(server: Processes) -> None:
    assert server.stop("optimizer") == 0
