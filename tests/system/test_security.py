"""Nobody gets in who is not on the roster, and who is reaches nothing but its own subtree.

Real router and services over real TLS and QUIC. Attacks use Zenoh itself, with the credentials of
a robot. What must not arrive is sent before something that must, on the same session: once that
has arrived, the rest has been refused.
"""

from __future__ import annotations

import functools
import logging
import queue
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh

from covinz import keyexprs
from covinz.access import certificates, credentials, enrolment
from covinz.access.credentials import Credentials, CredentialsError, with_credentials
from covinz.access.enrolment import Request
from covinz.access.roster import Identity, Roster
from covinz.agent import Agent
from covinz.bus import BusError, ZenohBus, open_router, why_not
from covinz.bus.settings import client_settings
from covinz.config import BusConfig
from covinz.run import free_port
from covinz.types import Correction
from tests.uploads import content

WAIT_S = 30.0
HOST = "127.0.0.1"
ROBOT, OTHER = "robot-1", "robot-2"
StartService = Callable[..., subprocess.Popen[str]]
OpenBus = Callable[[], ZenohBus]

# Everything that is not the robot's, and what the server alone may say in the robot's own subtree.
FOREIGN = (
    keyexprs.agent_keyframe(OTHER),
    keyexprs.agent_camera(OTHER),
    keyexprs.agent_correction(OTHER),
    keyexprs.agent_alive(OTHER),
    keyexprs.LOG_HEAD,
    keyexprs.LOG_RANGE,
    "covinz/keyframe/robot-2/01J9Z0000000000000000000AA/0",
    "covinz/camera/00",
    keyexprs.JOB_LEASE,
    keyexprs.JOB_DONE,
    keyexprs.JOB_LIST,
    keyexprs.worker_alive("w"),
    keyexprs.LOOP,
    keyexprs.REJECTION,
    keyexprs.MAP_LIST,
    keyexprs.map_snapshot("m"),
    keyexprs.service_alive("ingest", "ingest"),
    keyexprs.service_status("ingest", "ingest"),
    "covinz/agent",
    "covinz/view/x",
    "elsewhere",
)
WILD = ("**", "covinz/**", "covinz/agent/**", "covinz/agent/*/up/keyframe", "*/agent/robot-1/up/**")
OWN_ODOMETRY = f"covinz/agent/{ROBOT}/up/odometry"
OWN_CORRECTION = keyexprs.agent_correction(ROBOT)
OWN_ALIVE = keyexprs.agent_alive(ROBOT)


@pytest.fixture
def roster(tmp_path: Path) -> Roster:
    """A server's roster with two robots, whose files are in ``tmp_path``."""
    roster = Roster(tmp_path / "data" / "roster")
    port = free_port()
    for name in (ROBOT, OTHER):
        let_in(roster, Request(name, host=HOST, port=port))
    return roster


@pytest.fixture
def bus_config(roster: Roster) -> BusConfig:
    """The bus of the server's own processes."""
    port = roster.read().port
    return BusConfig(
        endpoint=f"tls/{HOST}:{port}",
        listen=(f"tls/{HOST}:{port}", f"quic/{HOST}:{port}"),
        roster=roster.folder,
        credentials=roster.server_credentials,
    )


@pytest.fixture
def router(start_service: StartService) -> subprocess.Popen[str]:
    return start_service("router")


@pytest.fixture
def server(router: subprocess.Popen[str], open_bus: OpenBus) -> ZenohBus:
    """A process of the server's."""
    bus = open_bus()
    assert bus.wait_connected(WAIT_S)
    return bus


@pytest.fixture
def attacker(server: ZenohBus, roster: Roster) -> Iterator[zenoh.Session]:
    """Zenoh with the credentials of the robot, and no scruples."""
    with zenoh.open(client_settings(bus_of(roster, ROBOT))) as session:
        yield session


@pytest.fixture
def spy(server: ZenohBus, roster: Roster) -> Iterator[zenoh.Session]:
    """A second session of the attacker."""
    with zenoh.open(client_settings(bus_of(roster, ROBOT))) as session:
        yield session


def let_in(roster: Roster, request: Request) -> Credentials:
    """Add to the roster; the credentials are in a file next to the server's folder."""
    made = enrolment.add(roster, request)
    credentials.write_secret(file_of(roster, request.name), made.text())
    return made


def file_of(roster: Roster, name: str) -> Path:
    return roster.folder.parents[1] / f"{name}.covinz"


def bus_of(roster: Roster, name: str) -> BusConfig:
    return with_credentials(BusConfig(), file_of(roster, name))


def forged(roster: Roster, base: Credentials, **changes: str) -> BusConfig:
    """The bus of somebody with altered credentials."""
    file = file_of(roster, "forged")
    credentials.write_secret(file, base.model_copy(update=changes).text())
    return with_credentials(BusConfig(), file)


def connect(settings: zenoh.Config) -> None:
    """Connect and go; raises ZError when the router does not let us in."""
    with zenoh.open(settings):
        pass


def arrivals(bus: ZenohBus, key: str = "**") -> queue.Queue[str]:
    """Keys of everything that is published."""
    arrived: queue.Queue[str] = queue.Queue()
    bus.subscribe(key, lambda key, _: arrived.put(key))
    return arrived


def pass_the_router(session: zenoh.Session, arrived: queue.Queue[str]) -> None:
    """Until the router has dealt with everything that `session` said so far."""
    session.put(OWN_ODOMETRY, b"", congestion_control=zenoh.CongestionControl.BLOCK)
    assert arrived.get(timeout=WAIT_S) == OWN_ODOMETRY


def test_a_robot_cannot_write_elsewhere(server: ZenohBus, attacker: zenoh.Session) -> None:
    arrived = arrivals(server)
    for key in (*FOREIGN, *WILD, OWN_CORRECTION, OWN_ALIVE):
        attacker.put(key, b"x", congestion_control=zenoh.CongestionControl.BLOCK)
        attacker.delete(key, congestion_control=zenoh.CongestionControl.BLOCK)
    attacker.delete(OWN_ODOMETRY, congestion_control=zenoh.CongestionControl.BLOCK)
    pass_the_router(attacker, arrived)
    assert arrived.empty()


def test_a_robot_cannot_ask_elsewhere(server: ZenohBus, attacker: zenoh.Session) -> None:
    asked: queue.Queue[str] = queue.Queue()

    def answer(query: object) -> None:
        asked.put(query.key)  # type: ignore[attr-defined]
        query.reply(b"secret")  # type: ignore[attr-defined]

    for key in ("covinz/**", "elsewhere", keyexprs.AGENT_KEYFRAMES):
        server.answer(key, answer)
    own = keyexprs.agent_keyframe(ROBOT)
    wait_answered(server, own)
    for key in (*FOREIGN, *WILD, "@/**"):
        replies = list(attacker.get(key, target=zenoh.QueryTarget.ALL, timeout=WAIT_S))
        found = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
        # Zenoh's own session answers for itself, without the router.
        assert [key for key in found if not key.startswith(f"@/{attacker.zid()}/")] == [], key
    assert asked.empty()
    assert [reply.ok is not None for reply in attacker.get(own, timeout=WAIT_S)]
    assert asked.get(timeout=WAIT_S) == own


def test_a_robot_cannot_answer_for_anybody(
    server: ZenohBus, attacker: zenoh.Session, roster: Roster
) -> None:
    arrived = arrivals(server)
    hijacked: queue.Queue[str] = queue.Queue()

    def answer(query: zenoh.Query) -> None:
        hijacked.put(str(query.key_expr))
        query.reply(query.key_expr, b"forged")

    own = (keyexprs.agent_keyframe(ROBOT), OWN_CORRECTION)
    held = [
        attacker.declare_queryable(key, answer, complete=True) for key in (*FOREIGN, *WILD, *own)
    ]
    pass_the_router(attacker, arrived)
    with closing(ZenohBus.open(bus_of(roster, OTHER))) as other:
        assert other.wait_connected(WAIT_S)
        for asker in (server, other):
            for key in (*FOREIGN, *own):
                assert asker.ask(key, timeout_s=WAIT_S) == [], key
    assert hijacked.empty()
    del held  # held until here


def test_a_robot_cannot_listen_elsewhere(server: ZenohBus, attacker: zenoh.Session) -> None:
    arrived = arrivals(server, OWN_ODOMETRY)
    heard: queue.Queue[str] = queue.Queue()

    def hear(sample: zenoh.Sample) -> None:
        heard.put(str(sample.key_expr))

    held = [attacker.declare_subscriber(key, hear) for key in (*FOREIGN, *WILD)]
    pass_the_router(attacker, arrived)
    held.append(attacker.declare_subscriber(OWN_CORRECTION, hear))
    pass_the_router(attacker, arrived)
    for key in FOREIGN:
        server.put(key, b"secret")
    server.put(OWN_CORRECTION, b"for it")
    while (key := heard.get(timeout=WAIT_S)) != OWN_CORRECTION:
        # Its own session hands its own odometry to its own subscriptions; nobody else does.
        assert key == OWN_ODOMETRY
    assert set(heard.queue) <= {OWN_CORRECTION}


def test_a_robot_cannot_claim_or_see_that_others_are_alive(
    server: ZenohBus, attacker: zenoh.Session, spy: zenoh.Session
) -> None:
    arrived = arrivals(server, OWN_ODOMETRY)  # first: what is seen below comes after it is known
    seen: queue.Queue[str] = queue.Queue()
    others = keyexprs.service_alive("router", "router")
    server.watch_alive("**", lambda key, _: seen.put(key) if key != others else None)
    held = [attacker.liveliness().declare_token(key) for key in (*FOREIGN, *WILD)]
    held.append(attacker.liveliness().declare_token(OWN_ALIVE))
    assert seen.get(timeout=WAIT_S) == OWN_ALIVE
    assert seen.empty()

    heard: queue.Queue[str] = queue.Queue()
    # Zenoh's own session knows its own tokens without the router, so it is another one that looks.
    watched = [
        spy.liveliness().declare_subscriber(
            key, lambda sample: heard.put(str(sample.key_expr)), history=True
        )
        for key in (*WILD, *FOREIGN)
    ]
    server.declare_alive(keyexprs.service_alive("ingest", "ingest"))
    server.declare_alive(keyexprs.worker_alive("w"))
    assert {seen.get(timeout=WAIT_S) for _ in range(2)} == {
        keyexprs.service_alive("ingest", "ingest"),
        keyexprs.worker_alive("w"),
    }
    found = [
        str(reply.ok.key_expr)
        for key in WILD
        for reply in spy.liveliness().get(key, timeout=WAIT_S)
        if reply.ok is not None
    ]
    assert found == []
    watched.append(
        spy.declare_subscriber(OWN_CORRECTION, lambda sample: heard.put(str(sample.key_expr)))
    )
    pass_the_router(spy, arrived)
    server.put(OWN_CORRECTION, b"for it")
    assert heard.get(timeout=WAIT_S) == OWN_CORRECTION
    del held, watched  # held until here


def test_robots_upload_and_are_corrected_through_tls_and_quic(
    server: ZenohBus, roster: Roster, start_service: StartService, tmp_path: Path
) -> None:
    let_in(roster, Request(OTHER, transport="quic", replace=True))
    assert credentials.read(file_of(roster, OTHER)).endpoint.startswith("quic/")
    for name in ("ingest", "place_recognition", "optimizer"):
        start_service(name)
    for name in (ROBOT, OTHER):
        corrected: queue.Queue[Correction] = queue.Queue()
        alive: queue.Queue[str] = queue.Queue()
        watch = server.watch_alive(keyexprs.agent_alive(name), functools.partial(note, alive))
        file, spool = file_of(roster, name), tmp_path / f"{name}.sqlite"
        with Agent(name, file, spool, on_correction=corrected.put) as agent:
            sent = [agent.send(content(seq)) for seq in range(3)]
            assert agent.wait_delivered(WAIT_S)
            assert corrected.get(timeout=WAIT_S).keyframe.session == sent[0].session
            assert alive.get(timeout=WAIT_S) == keyexprs.agent_alive(name)
        watch.close()


def test_an_agent_takes_an_endpoint_and_the_credentials_for_it(
    server: ZenohBus, roster: Roster, start_service: StartService, tmp_path: Path
) -> None:
    start_service("ingest")
    quic = credentials.read(file_of(roster, ROBOT)).endpoint.replace("tls/", "quic/")
    file = str(file_of(roster, ROBOT))
    with Agent(ROBOT, quic, tmp_path / "spool", credentials=file) as agent:
        agent.send(content(0))
        assert agent.wait_delivered(WAIT_S)


def test_an_agent_refuses_credentials_that_are_not_its_own_or_have_expired(
    roster: Roster, tmp_path: Path
) -> None:
    with pytest.raises(CredentialsError, match=f"of {OTHER}, not {ROBOT}"):
        Agent(ROBOT, file_of(roster, OTHER), tmp_path / "spool")
    let_in(roster, Request("late", lifetime=-timedelta(seconds=1)))
    with pytest.raises(CredentialsError, match=r"expired on .*--replace"):
        Agent("late", file_of(roster, "late"), tmp_path / "spool")


@pytest.mark.usefixtures("server")
@pytest.mark.parametrize("transport", ["tls", "quic"])
def test_who_is_not_on_the_roster_gets_no_connection(
    roster: Roster, tmp_path: Path, transport: str
) -> None:
    ours = credentials.read(file_of(roster, ROBOT))
    endpoint = ours.endpoint.replace("tls/", f"{transport}/")
    fleet = Roster(tmp_path / "other")
    theirs = enrolment.add(fleet, Request(ROBOT, host=HOST))
    # The key of a robot signs for another robot.
    signer = Identity(ours.certificate, ours.key)
    until = datetime.now(UTC) + timedelta(days=1)
    made = certificates.client_identity(signer, f"agent.{OTHER}", until)
    intruders = {
        "of another fleet": forged(roster, theirs, endpoint=endpoint),
        "who knows our authority": forged_as(roster, theirs, ours.authority, endpoint, "f1"),
        "a robot's own signature": forged_as(
            roster,
            theirs.model_copy(
                update={"certificate": made.certificate_pem + ours.certificate, "key": made.key_pem}
            ),
            ours.authority,
            endpoint,
            "f2",
        ),
    }
    for config in intruders.values():
        with pytest.raises(zenoh.ZError, match="Unable to connect"):
            connect(client_settings(config))
    with zenoh.open(client_settings(bus_of(roster, ROBOT))):
        pass  # the server is there for whom it knows


def forged_as(
    roster: Roster, base: Credentials, authority: str, endpoint: str, name: str
) -> BusConfig:
    file = file_of(roster, name)
    credentials.write_secret(
        file, base.model_copy(update={"authority": authority, "endpoint": endpoint}).text()
    )
    return with_credentials(BusConfig(), file)


@pytest.mark.usefixtures("server")
def test_without_a_certificate_or_without_tls_there_is_no_connection(roster: Roster) -> None:
    ours = credentials.read(file_of(roster, ROBOT))
    settings = zenoh.Config.from_json5(
        f'{{mode: "client", connect: {{endpoints: ["{ours.endpoint}"], timeout_ms: 0}}}}'
    )
    authority = file_of(roster, "authority")
    authority.write_text(ours.authority)
    settings.insert_json5("transport/link/tls/root_ca_certificate", f'"{authority}"')
    with pytest.raises(zenoh.ZError, match="Unable to connect"):
        connect(settings)
    plain = BusConfig(endpoint=ours.endpoint.replace("tls/", "tcp/"))
    with pytest.raises(zenoh.ZError, match="Unable to connect"):
        connect(client_settings(plain))
    assert "needs credentials" in why_not(plain)


def test_a_robot_cannot_take_over_the_session_of_another(server: ZenohBus, roster: Roster) -> None:
    server.answer(keyexprs.AGENT_KEYFRAMES, lambda query: query.reply(b"stored"))
    with zenoh.open(client_settings(bus_of(roster, OTHER))) as victim:
        forged = client_settings(bus_of(roster, ROBOT))
        forged.insert_json5("id", f'"{victim.zid()}"')
        with pytest.raises(zenoh.ZError, match="Unable to connect"):
            connect(forged)
        wait_answered(server, keyexprs.agent_keyframe(OTHER))
        replies = list(victim.get(keyexprs.agent_keyframe(OTHER), timeout=WAIT_S))
        assert [reply.ok is not None for reply in replies] == [True]


def test_a_robot_cannot_play_the_server(roster: Roster, tmp_path: Path) -> None:
    """With all that one robot has, nobody can make the other one connect to it."""
    ours = credentials.read(file_of(roster, ROBOT))
    trap = Roster(tmp_path / "trap")
    enrolment.add(trap, Request(OTHER, host=HOST))
    credentials.write_secret(trap.router, ours.certificate + ours.key)
    port = free_port()
    here = f"tls/{HOST}:{port}"
    with closing(open_router(BusConfig(endpoint=here, roster=trap.folder))):
        victim = with_credentials(BusConfig(), file_of(roster, OTHER), here)
        with pytest.raises(zenoh.ZError, match="Unable to connect"):
            connect(client_settings(victim))
        assert "not the server that these credentials are for" in why_not(victim)


class Complaints(logging.Handler):
    """Collects what the log says of the link."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: queue.Queue[str] = queue.Queue()

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.put(record.getMessage())


@pytest.fixture
def complaints() -> Iterator[Complaints]:
    log = logging.getLogger("covinz.bus.link")
    handler = Complaints()
    log.addHandler(handler)
    yield handler
    log.removeHandler(handler)


def test_who_is_removed_is_thrown_out_and_others_only_reconnect(
    server: ZenohBus,
    roster: Roster,
    start_service: StartService,
    tmp_path: Path,
    complaints: Complaints,
) -> None:
    start_service("ingest")
    changes: queue.Queue[bool] = queue.Queue()
    with (
        Agent(ROBOT, file_of(roster, ROBOT), tmp_path / "1.sqlite") as stays,
        Agent(OTHER, file_of(roster, OTHER), tmp_path / "2.sqlite") as goes,
        closing(ZenohBus.open(bus_of(roster, OTHER))) as link,
    ):
        link.watch_answered(keyexprs.agent_keyframe(OTHER), changes.put)
        for agent in (stays, goes):
            agent.send(content(0))
            assert agent.wait_delivered(WAIT_S)
        assert changes.get(timeout=WAIT_S) is True
        enrolment.remove(roster, OTHER)
        assert changes.get(timeout=WAIT_S) is False
        let_in(roster, Request("robot-3"))  # the router follows again
        goes.send(content(1))
        with Agent("robot-3", file_of(roster, "robot-3"), tmp_path / "3.sqlite") as comes:
            for agent in (stays, comes):
                agent.send(content(1))
                assert agent.wait_delivered(WAIT_S)
        assert goes.pending == 1
        # The robot's log says why, in time.
        while f"{OTHER} was removed from its roster" not in complaints.texts.get(timeout=WAIT_S):
            pass
        assert f"{OTHER} was removed" in why_not(bus_of(roster, OTHER))
        with pytest.raises(zenoh.ZError, match="Unable to connect"):
            connect(client_settings(bus_of(roster, OTHER)))


def test_who_expires_is_thrown_out_and_told_why(server: ZenohBus, roster: Roster) -> None:
    let_in(roster, Request("brief", lifetime=timedelta(seconds=12)))
    server.answer(keyexprs.AGENT_KEYFRAMES, lambda query: query.reply(b""))
    changes: queue.Queue[bool] = queue.Queue()
    with closing(ZenohBus.open(bus_of(roster, "brief"))) as link:
        link.watch_answered(keyexprs.agent_keyframe("brief"), changes.put)
        assert changes.get(timeout=WAIT_S) is True
        assert changes.get(timeout=WAIT_S) is False
        assert "these credentials expired on" in why_not(bus_of(roster, "brief"))
    with pytest.raises(zenoh.ZError, match="Unable to connect"):
        connect(client_settings(bus_of(roster, "brief")))


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:0", "tcp/10.8.0.1:7447", "udp/[::]:7447"])
def test_a_server_does_not_listen_to_other_machines_in_the_clear(endpoint: str) -> None:
    with pytest.raises(BusError, match="covinz roster add NAME --server HOST"):
        open_router(BusConfig(endpoint=endpoint))


def test_a_server_can_be_told_to_listen_in_the_clear() -> None:
    port = free_port()
    everywhere = BusConfig(endpoint=f"tcp/0.0.0.0:{port}", insecure=True)
    with (
        closing(open_router(everywhere)),
        closing(ZenohBus.open(BusConfig(endpoint=f"tcp/{HOST}:{port}"))) as bus,
    ):
        assert bus.wait_connected(WAIT_S)


def note(into: queue.Queue[str], key: str, _: object) -> None:
    into.put(key)


def wait_answered(bus: ZenohBus, key: str) -> None:
    there = threading.Event()
    with closing(bus.watch_answered(key, lambda is_there: there.set() if is_there else None)):
        assert there.wait(WAIT_S)
