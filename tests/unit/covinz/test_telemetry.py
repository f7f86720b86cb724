"""Durations, and questions that are timed."""

from __future__ import annotations

import threading
from contextlib import closing

from covinz.machine import ThisMachine
from covinz.memory_bus import Hub
from covinz.telemetry import BUCKETS_S, Telemetry


class Machine(ThisMachine):
    now_s = 0.0

    def monotonic_s(self) -> float:
        return self.now_s


def test_durations_add_up_over_threads() -> None:
    telemetry = Telemetry()

    def work() -> None:
        for _ in range(1000):
            telemetry.observe("a", 0.5)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found = telemetry.distributions()["a"]
    assert sum(found.counts) == found.counts[BUCKETS_S.index(0.5)] == 4000
    assert found.sum_s == 2000.0


def test_a_question_is_timed_until_its_answer_and_not_when_it_is_dropped() -> None:
    machine = Machine()
    telemetry = Telemetry(machine)
    hub = Hub()
    with closing(hub.join()) as server, closing(hub.join()) as asker:

        def answer(query: object) -> None:
            machine.now_s += 2.0
            query.reply(query.payload + query.key.encode())  # type: ignore[attr-defined]

        server.answer("covinz/a", telemetry.timed("slow", answer))
        server.answer("covinz/b", telemetry.timed("gone", lambda query: query.drop()))
        assert asker.ask("covinz/a", b"x") == [b"xcovinz/a"]
        assert asker.ask("covinz/b") == []
    assert list(telemetry.distributions()) == ["slow"]
    assert telemetry.distributions()["slow"].sum_s == 2.0
