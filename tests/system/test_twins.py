"""Two robots that were given the same id, over real processes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from covinz.agent import Agent
from covinz.doctor.server import of_server
from covinz.types import Keyframe
from services.ingest.twins import TURNS
from tests.processes import PATIENCE_S, Processes
from tests.uploads import content


def until(holds: Callable[[], object]) -> None:
    """Ask again and again; nothing says when it is so."""
    deadline_s, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while not holds():
        assert time.monotonic() < deadline_s
        pause.wait(0.05)


def test_the_later_one_is_told_and_waits_and_nobody_else_notices(tmp_path: Path) -> None:
    with (
        Processes(tmp_path) as server,
        Agent("clone", server.endpoint, tmp_path / "first.spool") as first,
        Agent("clone", server.endpoint, tmp_path / "second.spool") as second,
        Agent("other", server.endpoint, tmp_path / "other.spool") as other,
    ):
        server.start("router", "ingest")
        for k in range(2 * TURNS):
            first.send(content(k))
            assert first.wait_delivered(PATIENCE_S)
            second.send(content(100 + k))
            until(lambda: not second.pending or second.put_off)
        until(lambda: second.put_off)
        assert second.put_off is not None
        assert f"another robot sends as clone, session {first.session}" in second.put_off.reason
        assert second.pending
        first.send(content(50))
        other.send(content(0))
        assert first.wait_delivered(PATIENCE_S)
        assert other.wait_delivered(PATIENCE_S)
        assert first.put_off is None
        assert server.status("ingest").counters["twins.clone"] == 1
        assert "two robots send as clone" in server.log_of("ingest")
        findings = [finding.text for finding in of_server(server.bus)]
        assert any("two robots send as clone" in text for text in findings)
        by_session: dict[str, list[int]] = {}
        for entry in server.log_entries():
            assert isinstance(entry.item, Keyframe)
            by_session.setdefault(entry.item.id.session, []).append(entry.item.id.seq)
        assert by_session[first.session] == list(range(2 * TURNS + 1))
        waiting = second.pending
        held = by_session[second.session]
        assert held == list(range(2 * TURNS - waiting))
