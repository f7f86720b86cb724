from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from covinz import codec, keyexprs
from covinz.bus import BusClosed, BusError, Query
from covinz.config import Config
from covinz.durable import DurableFileError
from covinz.memory_bus import Hub, InMemoryBus
from covinz.service import Context, Inbox, StatusRequest, Stopped, serve_on
from covinz.types import Status

WAIT_S = 20.0
STATUS = keyexprs.service_status("test", "one")
ALIVE = keyexprs.service_alive("test", "one")


# --- the inbox ------------------------------------------------------------------------------


def test_events_come_out_in_order() -> None:
    inbox = Inbox()
    assert all(inbox.put(i) for i in range(5))
    assert inbox.take(0.0) == 0
    assert inbox.drain(2) == [1, 2]
    assert inbox.drain(10) == [3, 4]
    assert inbox.drain(10) == []
    assert inbox.take(0.0) is None


def test_a_full_inbox_turns_away_who_does_not_wait() -> None:
    inbox = Inbox(capacity=2)
    assert inbox.put(1) and inbox.put(2)
    assert not inbox.put(3, block=False)
    assert inbox.put_always("status")
    assert len(inbox) == 3
    assert not inbox.put(3, block=False)
    assert inbox.drain(3) == [1, 2, "status"]
    assert inbox.put(3, block=False)


def test_a_full_inbox_makes_a_patient_sender_wait() -> None:
    inbox = Inbox(capacity=1)
    inbox.put(0)
    outcome: queue.Queue[bool] = queue.Queue()

    def send() -> None:
        for event in (1, 2):
            outcome.put(inbox.put(event))

    sender = threading.Thread(target=send)
    sender.start()
    taken = [inbox.take(WAIT_S) for _ in range(3)]
    sender.join(WAIT_S)
    assert taken == [0, 1, 2]
    assert outcome.get() and outcome.get()


def test_a_stop_wakes_the_owner_and_the_senders() -> None:
    full, empty = Inbox(capacity=1), Inbox()
    full.put("waits")
    outcome: queue.Queue[object] = queue.Queue()

    def take() -> None:
        try:
            empty.take(None)
        except Stopped as stopped:
            outcome.put(stopped)

    threads = [
        threading.Thread(target=take),
        threading.Thread(target=lambda: outcome.put(full.put(1))),
    ]
    for thread in threads:
        thread.start()
    empty.stop()
    full.stop()
    for thread in threads:
        thread.join(WAIT_S)
    outcomes = [outcome.get(timeout=WAIT_S) for _ in range(2)]
    assert {type(each) for each in outcomes} == {Stopped, bool} and False in outcomes
    assert not full.put(2, block=False) and not full.put_always(3)
    with pytest.raises(Stopped):
        full.take(0.0)
    assert full.drain(5) == ["waits"]  # what was let in can still be finished


def test_many_senders_lose_nothing() -> None:
    inbox = Inbox(capacity=3)
    senders = [
        threading.Thread(target=lambda n=n: [inbox.put((n, i)) for i in range(200)])
        for n in range(4)
    ]
    for sender in senders:
        sender.start()
    taken = [inbox.take(WAIT_S) for _ in range(800)]
    for sender in senders:
        sender.join()
    for n in range(4):
        mine = [event for event in taken if isinstance(event, tuple) and event[0] == n]
        assert mine == [(n, i) for i in range(200)]


def test_an_inbox_that_holds_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="0 events"):
        Inbox(capacity=0)


# --- the shell ------------------------------------------------------------------------------


class Service:
    """Runs a service in a thread as a process would."""

    def __init__(self, bus: InMemoryBus, folder: Path) -> None:
        self.bus = bus
        self.inbox: Inbox | None = None
        self._folder = folder
        self._code: queue.Queue[int] = queue.Queue()

    def start(self, run: Callable[[Context], None]) -> None:
        armed = threading.Event()

        def arm(inbox: Inbox, _: object) -> None:
            self.inbox = inbox
            armed.set()

        def serve() -> None:
            code = serve_on(self.bus, "test", "one", Config(), self._folder, run, arm)
            self._code.put(code)

        threading.Thread(target=serve, daemon=True).start()
        assert armed.wait(WAIT_S)

    def stop(self) -> None:
        assert self.inbox is not None
        self.inbox.stop()

    def code(self) -> int:
        return self._code.get(timeout=WAIT_S)


@pytest.fixture
def hub() -> Hub:
    return Hub()


@pytest.fixture
def other(hub: Hub) -> Iterator[InMemoryBus]:
    with closing(hub.join()) as bus:
        yield bus


@pytest.fixture
def service(hub: Hub, tmp_path: Path) -> Iterator[Service]:
    with closing(hub.join()) as bus:
        yield Service(bus, tmp_path)


def answer_status(context: Context) -> None:
    while True:
        event = context.inbox.take(None)
        if isinstance(event, StatusRequest):
            status = Status(context.name, context.instance, "", 7, 0, 0, False)
            event.query.reply(codec.encode(status))


def test_a_service_answers_for_its_state_until_it_is_stopped(
    service: Service, other: InMemoryBus
) -> None:
    service.start(answer_status)
    replies = other.ask(STATUS)
    assert [codec.decode(reply, Status).cursor for reply in replies] == [7]
    service.stop()
    assert service.code() == 0
    assert other.ask(STATUS) == []


def test_a_service_is_alive_from_its_first_look_into_the_inbox_on(
    service: Service, other: InMemoryBus
) -> None:
    changes: queue.Queue[bool] = queue.Queue()
    other.watch_alive(ALIVE, lambda _, alive: changes.put(alive))
    begin = threading.Event()

    def run(context: Context) -> None:
        begin.wait(WAIT_S)
        answer_status(context)

    service.start(run)
    assert other.alive(ALIVE) == []
    begin.set()
    assert changes.get(timeout=WAIT_S) is True
    service.stop()
    assert changes.get(timeout=WAIT_S) is False
    assert service.code() == 0


def test_a_status_request_that_nobody_answers_is_dropped_at_the_end(
    service: Service, other: InMemoryBus
) -> None:
    waits, go_on = threading.Event(), threading.Event()

    def run(context: Context) -> None:
        context.inbox.put(context.inbox.take(None))
        waits.set()
        go_on.wait(WAIT_S)
        context.inbox.take(None)

    service.start(run)
    answers: queue.Queue[list[bytes]] = queue.Queue()
    threading.Thread(target=lambda: answers.put(other.ask(STATUS, b"", 600.0))).start()
    assert waits.wait(WAIT_S)
    service.stop()
    go_on.set()
    assert answers.get(timeout=WAIT_S) == []
    assert service.code() == 0


def test_a_failing_service_says_why_and_ends_with_an_error(
    service: Service, other: InMemoryBus, caplog: pytest.LogCaptureFixture
) -> None:
    def run(context: Context) -> None:
        context.inbox.take(0.0)
        raise ZeroDivisionError("a bug")

    service.start(run)
    assert service.code() == 1
    assert "ZeroDivisionError: a bug" in caplog.text
    assert other.alive(ALIVE) == []


@pytest.mark.parametrize("kind", [BusError, DurableFileError])
def test_an_expected_failure_needs_no_traceback(
    service: Service, kind: type[Exception], caplog: pytest.LogCaptureFixture
) -> None:
    def run(_: Context) -> None:
        raise kind("it is in use")

    service.start(run)
    assert service.code() == 1
    assert "it is in use" in caplog.text and "Traceback" not in caplog.text


def test_returning_unasked_is_an_error_and_returning_when_asked_is_not(service: Service) -> None:
    service.start(lambda _: None)
    assert service.code() == 1

    def run(context: Context) -> None:
        try:
            context.inbox.take(None)
        except Stopped:
            return

    service.start(run)
    service.stop()
    assert service.code() == 0


def test_a_question_that_a_stop_ended_is_a_clean_end(service: Service, other: InMemoryBus) -> None:
    asked: queue.Queue[Query] = queue.Queue()
    other.answer("covinz/never", asked.put)

    def run(context: Context) -> None:
        context.bus.ask("covinz/never", timeout_s=600.0)

    service.start(run)
    asked.get(timeout=WAIT_S)
    service.stop()
    service.bus.interrupt()
    assert service.code() == 0


def test_a_bus_that_closes_by_itself_is_an_error(
    service: Service, caplog: pytest.LogCaptureFixture
) -> None:
    def run(_: Context) -> None:
        raise BusClosed("unasked")

    caplog.set_level(logging.ERROR)
    service.start(run)
    assert service.code() == 1
    assert "unasked" in caplog.text
