"""Asking one process how it is, on an in-memory bus; exit codes are in tests/system."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from covinz import codec, health, keyexprs
from covinz.memory_bus import Hub, InMemoryBus
from covinz.program import instance_name
from covinz.types import Status

LOG = "01JD0000000000000000000000"
INGEST = Status("ingest", "ingest", LOG, cursor=7, pending=2, leased=0, dirty=True)
# Never waited out where somebody answers. [s]
PATIENCE_S = 20.0


@pytest.fixture
def hub() -> Hub:
    return Hub()


@pytest.fixture
def asker(hub: Hub) -> Iterator[InMemoryBus]:
    bus = hub.join()
    yield bus
    bus.close()


def answer(hub: Hub, status: Status) -> InMemoryBus:
    server = hub.join()
    key = keyexprs.service_status(status.service, status.instance)
    server.answer(key, lambda query: query.reply(codec.encode(status)))
    return server


def test_who_is_there_answers(hub: Hub, asker: InMemoryBus) -> None:
    server = answer(hub, INGEST)
    assert health.ask(asker, "ingest", "ingest", PATIENCE_S) == INGEST
    server.close()


def test_who_appears_in_time_answers(hub: Hub, asker: InMemoryBus) -> None:
    found: list[Status | None] = []
    asking = threading.Thread(
        target=lambda: found.append(health.ask(asker, "ingest", "ingest", PATIENCE_S))
    )
    asking.start()
    server = answer(hub, INGEST)
    asking.join()
    assert found == [INGEST]
    server.close()


def test_another_instance_does_not_answer_for_it(hub: Hub, asker: InMemoryBus) -> None:
    server = answer(hub, INGEST)
    assert health.ask(asker, "ingest", "ingest-2", 0.01) is None
    assert health.ask(asker, "optimizer", "ingest", 0.01) is None
    server.close()


def test_the_line_for_the_log() -> None:
    assert health.describe(INGEST) == "ingest/ingest: cursor 7, pending 2, leased 0, dirty"


def test_a_process_may_be_named_after_its_machine() -> None:
    assert instance_name("loop_solver-{host}") == f"loop_solver-{socket.gethostname()}"
    assert instance_name("ingest") == "ingest"
