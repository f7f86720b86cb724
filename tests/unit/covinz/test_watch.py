"""Work with a limit, and the thread that looks at it."""

from __future__ import annotations

import threading

from covinz.watch import FROZEN_S, TICK_S, Guard, Watch, Work

WAIT_S = 20.0


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def pass_time(clock: Clock, watch: Watch, seconds: float) -> Work | None:
    """What a guard that looks every tick sees at the end."""
    for _ in range(int(seconds / TICK_S)):
        clock.now_s += TICK_S
        stuck = watch.look()
    return stuck


def test_work_is_overdue_after_its_limit_and_not_when_it_ends() -> None:
    clock = Clock()
    watch = Watch(clock)
    short, long = watch.work("short", 10.0), watch.work("long", 60.0)
    with short, long:
        assert pass_time(clock, watch, 10.0) is None
        assert pass_time(clock, watch, 1.0) is short
        assert short.lasts_s == 11.0
    assert pass_time(clock, watch, 100.0) is None


def test_every_beginning_counts_anew() -> None:
    clock = Clock()
    watch = Watch(clock)
    work = watch.work("steps", 5.0)
    for _ in range(10):
        with work:
            assert pass_time(clock, watch, 4.0) is None


def test_time_in_which_nothing_ran_is_no_fault_of_the_work() -> None:
    clock = Clock()
    watch = Watch(clock)
    work = watch.work("a step", 10.0)
    idle = watch.work("idle", 10.0)
    work.begin()
    assert pass_time(clock, watch, 8.0) is None
    clock.now_s += FROZEN_S + 1000.0  # SIGSTOP, SIGCONT
    assert watch.look() is None
    assert pass_time(clock, watch, 10.0) is None
    assert pass_time(clock, watch, 1.0) is work
    assert idle.lasts_s == 0.0


def test_the_guard_beats_until_something_is_stuck() -> None:
    clock = Clock()
    watch = Watch(clock)
    work = watch.work("a step", 10.0)
    beats: list[float] = []
    given_up: list[Work] = []
    ended = threading.Event()

    def beat() -> None:
        beats.append(clock.now_s)
        work.begin()
        clock.now_s += 4.0  # below FROZEN_S, so that it counts
        if len(beats) > 1:
            ended.set()

    def give_up(stuck: Work) -> None:
        given_up.append(stuck)

    guard = Guard(watch, beat, silent_s=600.0, give_up=give_up)
    guard.start()
    assert ended.wait(WAIT_S)
    guard.stop()
    assert len(beats) >= 2 and given_up == []
