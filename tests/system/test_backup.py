"""A backup of a running server, restored in a new place: it goes on, to the same map."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import threading
import time
from pathlib import Path

from covinz import client, codec, keyexprs
from covinz.types import Duplicate, LoopClosure, MapSnapshot, RetryAfter, Stored, UploadReply
from tests.fleets import make_fleet
from tests.processes import CHECKOUT, PATIENCE_S, Processes
from tests.uploads import CAMERA, features

FLEET = make_fleet(seed=5, num_agents=2, length=60, loops_per_pair=8)
SERVICES = ("router", "ingest", "place_recognition", "optimizer")


def ask(server: Processes, key: str, payload: bytes) -> UploadReply:
    """Until there is an answer that is final, as robots and workers do."""
    deadline_s, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while True:
        for reply in server.bus.ask(key, payload):
            answer = codec.decode_upload_reply(reply)
            if not isinstance(answer, RetryAfter):
                return answer
        assert time.monotonic() < deadline_s
        pause.wait(0.1)


def send_all(server: Processes, begun: threading.Event) -> list[UploadReply]:
    """Keyframes of all robots in one order, and the loops among them; sets `begun` half-way."""
    answers = []
    for agent in ("agent0", "agent1"):
        ask(server, keyexprs.agent_camera(agent), codec.encode(CAMERA))
    loops: list[LoopClosure] = list(FLEET.loops)
    for number, kf in enumerate(FLEET.keyframes):
        full = dataclasses.replace(kf, camera_hash=CAMERA.hash, features=features(500, number))
        answers.append(ask(server, keyexprs.agent_keyframe(kf.id.agent), codec.encode(full)))
        if number % 6 == 5 and loops:
            ask(server, keyexprs.LOOP, codec.encode(loops.pop(0)))
        if number == len(FLEET.keyframes) // 3:
            begun.set()
    for loop in loops:
        ask(server, keyexprs.LOOP, codec.encode(loop))
    return answers


def command(*arguments: object) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "covinz.cli", *map(str, arguments)],
        cwd=CHECKOUT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def only_map_when_idle(server: Processes) -> MapSnapshot:
    client.wait_idle(server.bus, PATIENCE_S)
    (snapshot,) = client.snapshots(server.bus)
    return snapshot


def test_backup_restore_and_continue_give_the_same_map(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
    with Processes(tmp_path / "first") as server:
        server.start(*SERVICES)
        begun = threading.Event()
        robots = threading.Thread(target=send_all, args=(server, begun))
        robots.start()
        assert begun.wait(PATIENCE_S)
        command("backup", kept, "--data", server.data)
        robots.join(PATIENCE_S)
        assert not robots.is_alive()
        reference = only_map_when_idle(server)
        log_id = server.status("ingest").log_id

    with Processes(tmp_path / "second") as server:
        said = command("restore", kept, "--data", server.data)
        assert "the server may be started" in said
        server.start(*SERVICES)
        client.wait_idle(server.bus, PATIENCE_S)
        restored = server.status("ingest")
        assert restored.log_id == log_id
        head = restored.cursor
        assert len(FLEET.keyframes) // 3 <= head
        answers = send_all(server, threading.Event())
        assert answers == [Duplicate()] * head + [Stored()] * (len(answers) - head)
        again = only_map_when_idle(server)
        assert server.status("ingest").log_id == log_id
    assert again.keyframes == reference.keyframes
    for name in ("T_map_body", "T_from_to", "information", "edge_from", "edge_to", "is_loop"):
        assert getattr(again, name).tobytes() == getattr(reference, name).tobytes(), name
    assert again.is_loop.sum() == len(FLEET.loops)
