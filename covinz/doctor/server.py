"""What an operator sees: every process, what waits and fails, and each robot."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing

from covinz import client, keyexprs
from covinz.bus import Bus
from covinz.doctor import clocks
from covinz.doctor.agents import of_agent
from covinz.doctor.findings import Finding, Verdict
from covinz.types import Status

# Until all tokens that are there have come; nothing says which is the last. [s]
SETTLE_S = 1.0
# For one answer. [s]
ANSWER_S = 5.0
# Without one of these nothing goes on; loop solvers have a number in their names.
SERVICES = ("router", "ingest", "place_recognition", "loop_solver", "optimizer")
MISSING: Mapping[str, str] = {
    "loop_solver": "no candidate is verified: start at least one (covinz up --workers 1)",
    "ingest": "nothing is taken from robots, which keep their keyframes: see its log",
    "place_recognition": "no candidate is found: see its log",
    "optimizer": "no map is made and nobody corrected: see its log",
}
TROUBLE: Mapping[str, str] = {
    "disk_full": "make room on the disk of its data; it goes on by itself",
    "damaged": "its file is damaged: see its log, and covinz restore",
}
# Queries without any candidate that are no accident.
MANY_QUERIES = 50


def of_server(bus: Bus, settle_s: float = SETTLE_S) -> Iterator[Finding]:
    """Look at every process and at every robot that is or was there."""
    found = client.statuses(bus)
    names = {status.service for status in found}
    for name in SERVICES:
        if name not in names:
            advice = MISSING.get(name, "see its log")
            yield Finding(Verdict.BAD, f"{name} does not answer", advice)
    if not found:
        return
    yield Finding(Verdict.GOOD, f"{len(found)} processes answer: {', '.join(sorted(names))}")
    yield from _programs(bus, found)
    log_ids = {status.log_id for status in found if status.log_id}
    if len(log_ids) > 1:
        yield Finding(Verdict.ODD, "not all have begun to follow the log of this ingest yet")
    now = client.progress(bus)
    yield Finding(Verdict.GOOD, "nothing waits" if now.idle else f"at work: {now}")
    for status in found:
        yield from _work(status)
    for status in found:
        if status.service == "ingest":
            yield from _robots(bus, status, _alive(bus, settle_s))


def _programs(bus: Bus, found: Sequence[Status]) -> Iterator[Finding]:
    versions = {status.version for status in found}
    if len(versions) > 1:
        told = ", ".join(sorted(f"{each.instance} {each.version or '?'}" for each in found))
        yield Finding(
            Verdict.BAD,
            f"the server's processes are of different versions: {told}",
            "start all of them anew from the same version",
        )
    else:
        yield from clocks.version(found[0])
    first = found[0]
    key = keyexprs.service_status(first.service, first.instance)
    if (answer := clocks.ask(bus, key, ANSWER_S)) is not None:
        yield from clocks.clock(answer)


def _work(status: Status) -> Iterator[Finding]:
    """What a process counts that should not be."""
    counters = status.counters
    for name, advice in TROUBLE.items():
        if counters.get(f"cannot_store.{name}"):
            yield Finding(Verdict.BAD, f"{status.instance} cannot store: {name}", advice)
    if status.service == "place_recognition":
        yield from _recognition(counters)
    if faulty := counters.get("faulty_loops"):
        yield Finding(
            Verdict.ODD,
            f"{faulty:g} loops are left out of the maps, which could not be optimised with them",
            f"the log of {status.instance} names them",
        )


def _recognition(counters: Mapping[str, float]) -> Iterator[Finding]:
    if dead := counters.get("rejected.dead_letter"):
        yield Finding(
            Verdict.BAD,
            f"{dead:g} jobs are given up: every worker that took them failed",
            "covinz jobs lists them; covinz jobs replay ID tries one again",
        )
    if shed := counters.get("rejected.shed"):
        yield Finding(
            Verdict.ODD,
            f"{shed:g} candidates were given up unverified, since too many waited",
            "add loop solvers (covinz up --workers, compose --scale loop_solver=), or raise "
            "place_recognition.max_pending_jobs",
        )
    if other := counters.get("skipped.feature_type"):
        yield Finding(
            Verdict.BAD,
            f"{other:g} keyframes only have kinds of features that are not in use",
            "send one of those in loop_solver.kinds, or add theirs there",
        )
    queries, candidates = counters.get("queries", 0.0), counters.get("candidates", 0.0)
    waiting, accepted = counters.get("waiting", 0.0), counters.get("accepted", 0.0)
    if queries >= MANY_QUERIES and not candidates:
        text = f"{queries:g} keyframes were looked up, none looks like another"
        if waiting:
            text = f"{waiting:g} candidates wait: their keyframes have not moved enough for scale"
        yield Finding(
            Verdict.ODD,
            text,
            "robots must come to the same place, and move there, with the same kind of features",
        )
    stages = {
        name.removeprefix("rejected."): count
        for name, count in counters.items()
        if name.startswith("rejected.") and count
    }
    if stages and not accepted:
        most = max(stages, key=lambda stage: stages[stage])
        yield Finding(
            Verdict.ODD,
            f"of {sum(stages.values()):g} candidates none became a loop, most: {most}",
            'covinz why ROBOT; docs/agents.md, "Why is there no loop?", explains the reasons',
        )


def _robots(bus: Bus, ingest: Status, alive: set[str]) -> Iterator[Finding]:
    """What each robot sent, and what was refused."""
    per_robot = {
        name.removeprefix("keyframes."): count
        for name, count in ingest.counters.items()
        if name.startswith("keyframes.")
    }
    for robot in sorted(alive | per_robot.keys()):
        count = per_robot.get(robot, 0)
        here = "connected" if robot in alive else "not connected"
        verdict = Verdict.GOOD if count else Verdict.ODD
        yield Finding(verdict, f"{robot}: {here}, {count:g} keyframes stored")
        if ingest.counters.get(f"twins.{robot}"):
            yield Finding(
                Verdict.BAD,
                f"two robots send as {robot}; only the first one's keyframes are taken",
                "give each robot an id, and credentials, of its own",
            )
        if ingest.counters.get(f"twins.{robot}"):
            yield Finding(
                Verdict.BAD,
                f"{robot}: two programs send under this name",
                "the later one has to wait: give each robot a name, and credentials, of its own",
            )
        seen = clocks.ask(bus, keyexprs.agent_status(robot), ANSWER_S)
        if seen is not None and (robot in alive or seen.status.counters):
            yield from of_agent(robot, seen.status)
    if not alive | per_robot.keys():
        yield Finding(
            Verdict.ODD,
            "no robot has ever connected or sent anything",
            "start one: docs/agents.md; from elsewhere it needs credentials (covinz roster add)",
        )
    for name, count in sorted(ingest.counters.items()):
        if name.startswith("rejected."):
            code = name.removeprefix("rejected.")
            yield Finding(
                Verdict.BAD,
                f"{count:g} uploads refused: {code}",
                "what is said above of the robot, or ingest's log, names whose",
            )


def _alive(bus: Bus, settle_s: float) -> set[str]:
    """Robots that hold their token."""
    seen: set[str] = set()
    settled = threading.Event()

    def see(key: str, is_alive: bool) -> None:
        if is_alive:
            seen.add(keyexprs.agent_of(key))

    with closing(bus.watch_alive(keyexprs.AGENTS_ALIVE, see)):
        settled.wait(settle_s)
    return set(seen)
