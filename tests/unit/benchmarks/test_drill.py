"""The drill sees what is lost, doubled or missing, and its cable does what its weather says."""

from __future__ import annotations

import random
import socket
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import pytest

from benchmarks import fault_drill
from benchmarks.drill import careless
from benchmarks.drill.cases import CLEAN, cases
from benchmarks.drill.link import FAIR, Direction, Weather
from benchmarks.drill.table import drill_section
from benchmarks.drill.verdict import End, Verdict, judge, places
from covinz.types import Gap, KeyframeId

SESSION = "01JD0000000000000000000000"
LATER = 1e3


def keyframe(seq: int, agent: str = "a0") -> KeyframeId:
    return KeyframeId(agent, SESSION, seq)


def end(seqs: Sequence[int], *, loops: dict[tuple[int, int], bytes], doubles: int = 0) -> End:
    gap = Gap("a0", SESSION, 90, 91, "spool full")
    named = {(str(keyframe(q)), str(keyframe(c))): T for (q, c), T in loops.items()}
    return End(tuple(map(keyframe, seqs)), (gap,), named, doubles, (("a0",),), {})


SENT = [str(keyframe(seq)) for seq in (0, 1, 2, 90)]


def test_an_end_as_it_should_be() -> None:
    undisturbed = end([0, 1, 2], loops={(2, 0): b"T"})
    # The order in the log is no matter here, and what a gap declares is not lost.
    verdict = judge(end([0, 2, 1], loops={(2, 0): b"T"}), SENT, undisturbed)
    assert verdict == Verdict(0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (end([0, 1], loops={(2, 0): b"T"}), Verdict(1, 0, 0, 0, 0)),
        (end([0, 1, 1, 1, 2], loops={(2, 0): b"T"}), Verdict(0, 2, 0, 0, 0)),
        (end([0, 1, 2], loops={(2, 0): b"T"}, doubles=3), Verdict(0, 3, 0, 0, 0)),
        (end([0, 1, 2], loops={}), Verdict(0, 0, 1, 0, 0)),
        (end([0, 1, 2], loops={(2, 0): b"T", (2, 1): b"T"}), Verdict(0, 0, 0, 1, 0)),
        (end([0, 1, 2], loops={(2, 0): b"S"}), Verdict(0, 0, 0, 0, 1)),
    ],
)
def test_what_is_wrong_with_an_end(found: End, verdict: Verdict) -> None:
    assert judge(found, SENT, end([0, 1, 2], loops={(2, 0): b"T"})) == verdict


def test_loops_are_compared_across_sessions_by_place() -> None:
    found = end([], loops={(2, 0): b"T"})
    assert places(found, {str(keyframe(2)): 7, str(keyframe(0)): 0}) == {("a0/7", "a0/0")}


class Cable:
    """One direction of the link between two sockets that keep packets apart."""

    def __init__(self) -> None:
        self.sender, inlet = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        outlet, self.receiver = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.receiver.setblocking(False)
        self.ends = (inlet, outlet)
        self.direction = Direction(inlet.fileno(), outlet.fileno(), random.Random(1))

    def carry(self, count: int, weather: Weather, at: float = 0.0) -> list[int]:
        """The numbers of the packets that had arrived at a time, of `count` sent at once."""
        for number in range(count):
            self.sender.send(bytes([number]) + bytes(99))
            self.direction.take(0.0, weather)
        self.direction.deliver(at)
        return list(self._received())

    def _received(self) -> Iterator[int]:
        while True:
            try:
                yield self.receiver.recv(200)[0]
            except BlockingIOError:
                return


@pytest.fixture
def cable() -> Iterator[Cable]:
    made = Cable()
    yield made
    for end_ in (made.sender, made.receiver, *made.ends):
        end_.close()


def test_fair_weather_carries_all_in_order_and_not_at_once(cable: Cable) -> None:
    assert cable.carry(8, FAIR, at=0.001) == []
    assert cable.carry(0, FAIR, at=LATER) == list(range(8))


@pytest.mark.parametrize(
    ("weather", "counts"),
    [(Weather(down=True), []), (Weather(loss=1.0), []), (Weather(repeats=1.0), [2] * 8)],
)
def test_weather_loses_and_repeats(cable: Cable, weather: Weather, counts: list[int]) -> None:
    assert list(Counter(cable.carry(8, weather, at=LATER)).values()) == counts


def test_loss_is_a_share(cable: Cable) -> None:
    arrived = [len(cable.carry(8, Weather(loss=0.3), at=LATER)) for _ in range(50)]
    assert 240 < sum(arrived) < 320
    assert sum(arrived) + cable.direction.dropped == 400


def test_late_packets_are_overtaken(cable: Cable) -> None:
    arrived = cable.carry(8, Weather(late=0.5), at=LATER)
    assert sorted(arrived) == list(range(8)) != arrived


def test_a_slow_link_takes_its_time_and_a_full_queue_drops(cable: Cable) -> None:
    # 100 bytes at 0.08 Mbit/s take 10 ms, and all take 5 ms more.
    slow = Weather(mbit_per_s=0.08)
    assert cable.carry(8, slow, at=0.036) == [0, 1, 2]
    assert cable.carry(0, slow, at=LATER) == [3, 4, 5, 6, 7]
    for _ in range(200):
        cable.carry(8, slow, at=LATER)
    assert cable.direction.dropped > 0


def test_careless_uploads_come_twice_and_out_of_order() -> None:
    order = list(careless.order(20))
    assert set(Counter(order).values()) == {2, 3}
    firsts = list(dict.fromkeys(order))
    assert sorted(firsts) == list(range(20)) != firsts


FIGURES: dict[str, Any] = {
    "title": "everything", "lost": 0, "duplicated": 0, "loops": 271, "loops_missing": 0,
    "loops_extra": 0, "loops_changed": 0, "recovery_s": 1.23, "backlog": 4,
    "send_block_ms_max": 12.3, "human_needed": 0, "failed": [],
}  # fmt: skip


def test_the_report_sums_what_was_played_and_never_counts_what_was_skipped() -> None:
    made = fault_drill.report(
        {
            CLEAN: FIGURES,
            "kill_ingest": FIGURES | {"lost": 2, "duplicated": 3, "failed": ["2 lost"]},
            "kill_router": {"title": "router", "human_needed": 1, "failed": ["stuck: x"]},
            "loss_5_quic": {"title": "loss", "skipped": "no right"},
        }
    )
    assert (made["cases"], made["cases_failed"], made["cases_skipped"]) == (3, 2, 1)
    assert made["keyframes_lost_total"] == 2
    assert made["duplicated_total"] == 3
    assert made["human_needed"] == 1
    assert list(made["case"]) == [CLEAN, "kill_router", "kill_ingest", "loss_5_quic"]
    text = drill_section(made)
    assert "| everything | 0 | 0 | 0 / 0 / 0 | 4 | 1.2 s | 12 ms |  |" in text
    assert "| router | - | - | - | - | - | - | stuck: x |" in text
    assert "skipped: no right" in text
    assert "3 cases, 2 failed, 1 skipped, " in text
    assert f"{len(cases()) - 4} of the drill not played" in text
    assert "; 2 keyframes lost, 3 duplicated" in text


def test_every_case_of_the_claim_is_there() -> None:
    known = cases()
    for victim in ("router", "ingest", "place_recognition", "worker", "all_workers", "optimizer"):
        assert f"kill_{victim}" in known and f"hang_{victim}" in known
    for transport in ("tls", "quic"):
        for weather in ("loss_5", "loss_10", "loss_30", "outage_3s", "outage_15s", "cap_2mbit"):
            assert known[f"{weather}_{transport}"].transport == transport
