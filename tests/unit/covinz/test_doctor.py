"""What is said of a server or a robot's way to it, over an in-memory bus."""

from __future__ import annotations

import time
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

from covinz import codec, doctor, keyexprs
from covinz.access.credentials import write_secret
from covinz.access.enrolment import Request, add
from covinz.access.roster import Roster
from covinz.bus import Bus
from covinz.config import BusConfig
from covinz.doctor import SERVICES, Verdict, calibration, examine, is_well, of_robot, of_server
from covinz.doctor.clocks import Answer, clock, version
from covinz.memory_bus import Hub
from covinz.program import VERSION
from covinz.types import Status

NO_WAIT_S = 0.02


def serve(bus: Bus, name: str, counters: Mapping[str, float] | None = None) -> None:
    status = Status(
        service=name,
        instance=name,
        log_id="",
        cursor=0,
        pending=0,
        leased=0,
        dirty=False,
        counters=dict(counters or {}),
        version=VERSION,
        now_ns=time.time_ns(),
    )
    key = keyexprs.service_status(name, name)
    bus.answer(key, lambda query: query.reply(codec.encode(status)))


def said(findings: list[doctor.Finding], verdict: Verdict) -> str:
    return "\n".join(finding.text for finding in findings if finding.verdict is verdict)


def test_a_server_that_works() -> None:
    hub = Hub()
    server = hub.join()
    for name in SERVICES:
        serve(server, name, {"keyframes": 5, "keyframes.a1": 5} if name == "ingest" else None)
    hub.join().declare_alive(keyexprs.agent_alive("a1"))
    found = list(of_server(hub.join(), NO_WAIT_S))
    assert is_well(found)
    assert "a1: connected, 5 keyframes stored" in said(found, Verdict.GOOD)
    assert "nothing waits" in said(found, Verdict.GOOD)
    assert said(found, Verdict.ODD) == ""


def test_who_is_missing_or_refused_is_named() -> None:
    hub = Hub()
    server = hub.join()
    serve(server, "ingest", {"rejected.malformed": 3, "keyframes.a1": 1, "twins.a1": 1})
    hub.join().declare_alive(keyexprs.agent_alive("a2"))
    found = list(of_server(hub.join(), NO_WAIT_S))
    assert not is_well(found)
    for name in set(SERVICES) - {"ingest"}:
        assert f"{name} does not answer" in said(found, Verdict.BAD)
    assert "3 uploads refused: malformed" in said(found, Verdict.BAD)
    assert "a1: two programs send under this name" in said(found, Verdict.BAD)
    assert said(found, Verdict.ODD) == "a2: connected, 0 keyframes stored"
    assert all(finding.advice for finding in found if finding.verdict is Verdict.BAD)
    assert "a1: not connected, 1 keyframes stored" in said(found, Verdict.GOOD)


def test_a_server_without_robots_says_so() -> None:
    hub = Hub()
    serve(hub.join(), "ingest")
    assert "no robot has ever" in said(list(of_server(hub.join(), NO_WAIT_S)), Verdict.ODD)


def test_a_server_of_which_nothing_answers() -> None:
    found = list(of_server(Hub().join(), NO_WAIT_S))
    assert [finding.verdict for finding in found] == [Verdict.BAD] * len(SERVICES)


def test_a_robot_learns_what_the_server_lacks() -> None:
    hub = Hub()
    server = hub.join()
    (found,) = of_robot(hub.join(), "a1", NO_WAIT_S)
    assert found.verdict is Verdict.BAD
    assert found.text == "nobody takes uploads: ingest is not up on the server"
    server.answer(keyexprs.AGENT_KEYFRAMES, lambda query: query.drop())
    found = list(of_robot(hub.join(), "a1", NO_WAIT_S))[-1]
    assert "nobody gives corrections: optimizer" in found.text
    without = server.answer(keyexprs.AGENT_CORRECTIONS, lambda query: query.drop())
    found = list(of_robot(hub.join(), "a1", NO_WAIT_S))[-1]
    assert found.verdict is Verdict.ODD
    assert found.text == "no correction yet: no keyframe of a1 is in a map"
    without.close()
    server.answer(keyexprs.AGENT_CORRECTIONS, lambda query: query.reply(b"one"))
    found = list(of_robot(hub.join(), "a1", NO_WAIT_S))[-1]
    assert found.verdict is Verdict.GOOD and "a1 has been corrected" in found.text


def test_credentials_are_looked_at_before_anything_is_opened(tmp_path: Path) -> None:
    roster = Roster(tmp_path / "roster")
    for name, days in (("late", -1), ("soon", 3)):
        made = add(roster, Request(name, host="127.0.0.1", port=9, lifetime=timedelta(days=days)))
        write_secret(tmp_path / f"{name}.covinz", made.text())
    (missing,) = examine(BusConfig(credentials=tmp_path / "none"))
    assert missing.verdict is Verdict.BAD and "no usable credentials" in missing.text
    (late,) = examine(BusConfig(credentials=tmp_path / "late.covinz"))
    assert late.verdict is Verdict.BAD
    assert f"expired on {datetime.now(UTC) - timedelta(days=1):%Y-%m-%d}" in late.text
    (needed,) = examine(BusConfig(endpoint="tls/127.0.0.1:9"))
    assert needed.verdict is Verdict.BAD and "needs credentials" in needed.text
    soon = next(examine(BusConfig(credentials=tmp_path / "soon.covinz")))
    assert soon.verdict is Verdict.ODD and "good for 2 days" in soon.text


def answer(offset_s: float, within_s: float = 0.1) -> Answer:
    return Answer(Status("ingest", "ingest", "", 0, 0, 0, False), offset_s, within_s)


def test_clocks_that_differ_are_told_with_their_direction() -> None:
    for offset_s, words in ((3.0, "3.000 s ahead of"), (-3.0, "3.000 s behind")):
        (found,) = clock(answer(offset_s))
        assert found.verdict is Verdict.ODD and words in found.text and "NTP" in found.advice
    for offset_s, within_s in ((0.9, 0.0), (1.9, 1.0)):  # a slow answer proves nothing
        (found,) = clock(answer(offset_s, within_s))
        assert found.verdict is Verdict.GOOD


def test_another_version_is_told_and_no_harm() -> None:
    made = Status("ingest", "ingest", "", 0, 0, 0, False, version="9.9.9+messages.00000000")
    (found,) = version(made)
    assert found.verdict is Verdict.ODD
    assert "ingest 9.9.9" in found.text and VERSION in found.text
    (found,) = version(Status("ingest", "ingest", "", 0, 0, 0, False, version=VERSION))
    assert found.verdict is Verdict.GOOD


def test_processes_of_different_versions_do_not_belong_together() -> None:
    hub = Hub()
    serve(hub.join(), "router")
    old = Status("ingest", "ingest", "", 0, 0, 0, False, version="0.0.1")
    key = keyexprs.service_status("ingest", "ingest")
    hub.join().answer(key, lambda query: query.reply(codec.encode(old)))
    found = list(of_server(hub.join(), NO_WAIT_S))
    assert "ingest 0.0.1" in said(found, Verdict.BAD)


def test_what_a_server_counts_is_judged() -> None:
    hub = Hub()
    serve(hub.join(), "ingest", {"cannot_store.disk_full": 1})
    counters = {
        "queries": 100.0,
        "candidates": 0.0,
        "waiting": 7.0,
        "rejected.dead_letter": 2.0,
        "rejected.scale": 40.0,
        "rejected.shed": 9.0,
        "skipped.feature_type": 5.0,
    }
    serve(hub.join(), "place_recognition", counters)
    serve(hub.join(), "optimizer", {"faulty_loops": 3})
    found = list(of_server(hub.join(), NO_WAIT_S))
    bad, odd = said(found, Verdict.BAD), said(found, Verdict.ODD)
    assert "ingest cannot store: disk_full" in bad
    assert "2 jobs are given up" in bad
    assert "5 keyframes only have kinds of features that are not in use" in bad
    assert "7 candidates wait: their keyframes have not moved enough" in odd
    assert "of 51 candidates none became a loop, most: scale" in odd
    assert "3 loops are left out" in odd
    assert "9 candidates were given up unverified" in odd


def test_a_calibration_file_is_looked_at(tmp_path: Path) -> None:
    file = tmp_path / "calib.yaml"
    text = "model: PINHOLE\nwidth: 640\nheight: 480\nparams: [{}, {}, 320, 240]\n"
    file.write_text(text.format(500, 500))
    (found,) = calibration(file)
    assert found.verdict is Verdict.GOOD
    file.write_text(text.format(3.5, 3.5))
    (found,) = calibration(file)
    assert found.verdict is Verdict.BAD and "a focal length of 3.5 px" in found.text
    assert "millimetres" in found.advice
    file.write_text(text.format("a", 1))
    (found,) = calibration(file)
    assert found.verdict is Verdict.BAD and "params" in found.text
