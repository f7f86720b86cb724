"""When is the server idle? Statuses as the processes answer them, on an in-memory bus."""

from __future__ import annotations

import dataclasses

import pytest

from covinz import client, codec, keyexprs
from covinz.memory_bus import Hub
from covinz.types import Status

LOG, OTHER_LOG = "01JD0000000000000000000000", "01JD0000000000000000000001"
IDLE = {
    name: Status(name, name, LOG, cursor=7, pending=0, leased=0, dirty=False)
    for name in ("ingest", "place_recognition", "optimizer")
}
WORKER = Status("loop_solver", "loop_solver-0", "", cursor=0, pending=0, leased=0, dirty=False)


def progress(*answers: Status) -> client.Progress:
    """What a client makes of these answers."""
    hub = Hub()
    server, asker = hub.join(), hub.join()
    for status in answers:
        payload = codec.encode(status)
        key = keyexprs.service_status(status.service, status.instance)
        server.answer(key, lambda query, payload=payload: query.reply(payload))  # type: ignore[misc]
    found = client.progress(asker)
    asker.close()
    server.close()
    return found


def changed(service: str, **changes: object) -> list[Status]:
    """Idle statuses but for `changes` to one of them."""
    return [
        dataclasses.replace(status, **changes) if name == service else status  # type: ignore[arg-type]
        for name, status in IDLE.items()
    ]


def test_idle_is_when_nothing_is_left_to_do() -> None:
    assert progress(*IDLE.values()).idle
    assert progress(*IDLE.values(), WORKER).idle


def test_what_is_left_is_said_in_words() -> None:
    assert str(progress(*IDLE.values())) == "nothing left to do"
    busy = changed("place_recognition", cursor=5, pending=72, leased=1)
    assert str(progress(*busy)) == "2 keyframes to look up, 73 jobs open"
    late = changed("optimizer", cursor=4, dirty=True)
    assert str(progress(*late)) == "3 keyframes to map, maps to optimise"
    absent = list(IDLE.values())[1:]
    assert str(progress(*absent)) == "missing: ingest"


@pytest.mark.parametrize(
    "statuses",
    [
        changed("ingest", cursor=8),
        changed("place_recognition", cursor=6),
        changed("place_recognition", pending=1),
        changed("place_recognition", leased=1),
        changed("optimizer", cursor=6),
        changed("optimizer", dirty=True),
        changed("optimizer", log_id=OTHER_LOG),
        changed("place_recognition", log_id=""),
        list(IDLE.values())[1:],
        list(IDLE.values())[:-1],
    ],
)
def test_work_that_is_left_is_seen(statuses: list[Status]) -> None:
    assert not progress(*statuses).idle


def test_a_job_that_was_given_up_counts_while_a_worker_is_still_at_it() -> None:
    # A dead letter is no open job, but its worker may only be slow, and then its loop comes yet.
    slow = dataclasses.replace(WORKER, leased=1)
    found = progress(*IDLE.values(), WORKER, dataclasses.replace(slow, instance="loop_solver-1"))
    assert not found.idle
    assert found.busy_workers == 1
