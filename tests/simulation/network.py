"""The bus in the simulation: one router whose links lose, delay, repeat and reorder messages.

Members see what Zenoh shows (decision 0007): `ask` is empty at once when nobody answers, waits for
all who do, and says nothing about lost messages; tokens and answers of a member that is cut off
vanish for the others and come back with it.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from covinz.bus import BusClosed, Query, check_size
from covinz.config import BusConfig
from covinz.memory_bus import intersects
from tests.simulation.machine import SimulatedMachine
from tests.simulation.scheduler import Scheduler, Task

MAX_MESSAGE_BYTES = BusConfig().max_message_bytes
QUERY_TIMEOUT_S = BusConfig().query_timeout_s
# A router notices so late that a link is dead whose other end says nothing. [s; Zenoh's lease]
LINK_LEASE_S = 10.0


@dataclass(frozen=True, slots=True)
class Weather:
    """What the links do to messages.

    Attributes:
        loss: Share of messages that vanish.
        repeats: Share of questions and publications that are heard twice.
        lag: Share of messages that are much later than others, ...
        max_lag_s: ... by up to so much.
    """

    loss: float = 0.0
    repeats: float = 0.0
    lag: float = 0.0
    max_lag_s: float = 0.0


CALM = Weather()


class Network:
    """The router and all members.

    Attributes:
        weather: What the links do now.
        trace: Told about every message: what happened, who, key.
        on_answer: Told about every reply that reaches an asker: member, key, payload.
    """

    def __init__(self, scheduler: Scheduler, draw: random.Random) -> None:
        self.scheduler = scheduler
        self.weather = CALM
        self.trace: Callable[[str, str, str], object] = lambda *_: None
        self.on_answer: Callable[[SimulatedBus, str, bytes], object] = lambda *_: None
        self.members: list[SimulatedBus] = []
        self._is_up = True
        self._draw = draw

    def join(self, machine: SimulatedMachine) -> SimulatedBus:
        """A new member."""
        member = SimulatedBus(self, machine)
        self.members.append(member)
        return member

    def leave(self, member: SimulatedBus) -> None:
        """A member is gone, with all that it declared."""
        if member not in self.members:
            return
        self.members.remove(member)
        member.declared.clear()
        for query in member.asked:
            # The router ends what the lost link left open; or the asker's time runs out.
            if self._draw.random() < 0.7:
                self.send(None, query.end)
        self.changed()

    def set_router(self, is_up: bool) -> None:
        """The router dies, or is back."""
        self._is_up = is_up
        self.changed()

    def is_online(self, member: SimulatedBus) -> bool:
        """Whether a member's messages get through."""
        return self._is_up and member.has_link and member in self.members

    def declared(self, kind: str, key: str) -> list[Declaration]:
        """What members that are online have declared and `key` concerns."""
        return [
            declaration
            for member in self.members
            if self.is_online(member)
            for declaration in member.declared
            if declaration.kind == kind and intersects(declaration.key, key)
        ]

    def changed(self) -> None:
        """Tell every watch what has appeared and vanished for it, in that order, some time."""
        for member in list(self.members):
            for watch in list(member.declared):
                if watch.kind in ("watch_alive", "watch_answered"):
                    watch.look(self.is_online(member))

    def send(self, what: tuple[str, str, str] | None, deliver: Callable[[], object]) -> None:
        """Let a message arrive some time, or never; `what` is for the trace, None: not lost."""
        weather = self.weather
        if what is not None and self._draw.random() < weather.loss:
            self.trace("lost", what[1], f"{what[0]} {what[2]}")
            return
        self.scheduler.after(self.delay_s(), deliver)

    def delay_s(self) -> float:
        """How long a message takes."""
        delay_s = self._draw.uniform(1e-4, 2e-3)
        if self._draw.random() < self.weather.lag:
            delay_s += self._draw.uniform(0.0, self.weather.max_lag_s)
        return delay_s

    def is_repeated(self) -> bool:
        """Whether a message is heard twice."""
        return self._draw.random() < self.weather.repeats


class Declaration:
    """Something that a member declared: subscribe, answer, alive, watch_alive, watch_answered."""

    def __init__(
        self, owner: SimulatedBus, kind: str, key: str, callback: Callable[..., object]
    ) -> None:
        self.owner = owner
        self.kind = kind
        self.key = key
        self._callback = callback
        self._seen: set[str] = set()
        self._told_at_s = 0.0

    def call(self, *arguments: Any) -> None:
        """Call the callback in the owner's process, once it does not hang."""
        self.owner.deliver(lambda: self in self.owner.declared and self._callback(*arguments))

    def look(self, is_online: bool) -> None:
        """For a watch: tell what appeared and what vanished since last time."""
        network = self.owner.network
        if self.kind == "watch_alive":
            now = {d.key for d in network.declared("alive", self.key)} if is_online else set()
        else:
            now = {self.key} if is_online and network.declared("answer", self.key) else set()
        for key, is_there in [
            *((key, True) for key in sorted(now - self._seen)),
            *((key, False) for key in sorted(self._seen - now)),
        ]:
            self._tell(key, is_there)
        self._seen = now

    def _tell(self, key: str, is_there: bool) -> None:
        scheduler = self.owner.network.scheduler
        time_s = max(self._told_at_s, scheduler.now_s + self.owner.network.delay_s())
        self._told_at_s = time_s
        scheduler.at(time_s, lambda: self.call(key, is_there))

    def close(self) -> None:
        """Withdraw it."""
        self.owner.machine.check()
        if self in self.owner.declared:
            self.owner.declared.remove(self)
            self.owner.network.changed()


class _Question:
    """An asker's wait for the end of all queries that its question became."""

    def __init__(self, asker: SimulatedBus, key: str) -> None:
        self.asker = asker
        self.key = key
        self.num_open = 0
        self.replies: list[bytes] = []
        self.is_over = False
        self.waiters: list[Task] = []

    def arrive(self, reply: bytes | None) -> None:
        """A reply, or the end of one query, reaches the asker."""
        if self.is_over:
            return
        if reply is not None:
            self.replies.append(reply)
        self.num_open -= 1
        if self.num_open <= 0:
            self.end()

    def end(self) -> None:
        """There is nothing to wait for any more."""
        self.is_over = True
        self.asker.network.scheduler.wake_all(self.waiters)


class SimulatedQuery:
    """A question as one answerer has it; see `covinz.bus.Query`."""

    def __init__(
        self,
        key: str,
        payload: bytes,
        question: _Question,
        answerer: SimulatedBus,
        is_echo: bool = False,
    ) -> None:
        self.key = key
        self.payload = payload
        self._question = question
        self._answerer = answerer
        self._is_echo = is_echo
        self._has_ended = False

    def reply(self, payload: bytes) -> None:
        """See `Query.reply`."""
        self._answerer.machine.check()
        check_size(payload, MAX_MESSAGE_BYTES)
        self._finish(bytes(payload))

    def drop(self) -> None:
        """See `Query.drop`."""
        self._answerer.machine.check()
        self._finish(None)

    def end(self) -> None:
        """The router ends it: the answerer is gone."""
        if not (self._has_ended or self._is_echo):
            self._has_ended = True
            self._question.arrive(None)

    def _finish(self, reply: bytes | None) -> None:
        network, asker = self._answerer.network, self._question.asker
        if self._has_ended:
            return
        self._has_ended = True
        self._answerer.asked.remove(self)
        name = self._answerer.machine.name
        network.trace("drops" if reply is None else "replies", name, self.key)
        if self._is_echo or not network.is_online(self._answerer):
            return

        def arrive() -> None:
            if network.is_online(asker):
                asker.deliver(lambda: self._question.arrive(reply))

        network.send(("reply", name, self.key), arrive)


class SimulatedBus:
    """One member of the network; see `covinz.bus.Bus` for what the methods do.

    Attributes:
        has_link: Its link to the router works.
        asked: Queries of others that wait here.
        declared: What it has declared.
    """

    def __init__(self, network: Network, machine: SimulatedMachine) -> None:
        self.network = network
        self.machine = machine
        self.has_link = True
        self.asked: list[SimulatedQuery] = []
        self.declared: list[Declaration] = []
        self._questions: list[_Question] = []
        self._is_interrupted = False
        self._inbound: list[Callable[[], object]] = []

    def put(self, key: str, payload: bytes) -> None:
        """See `Bus.put`."""
        self.machine.point()
        check_size(payload, MAX_MESSAGE_BYTES)
        network, name = self.network, self.machine.name
        network.trace("puts", name, key)
        if not network.is_online(self):
            return
        for subscription in network.declared("subscribe", key):
            for _ in range(1 + network.is_repeated()):
                network.send(("put", name, key), _publish(subscription, key, bytes(payload)))

    def subscribe(self, key: str, callback: Callable[[str, bytes], None]) -> Declaration:
        """See `Bus.subscribe`."""
        return self._declare("subscribe", key, callback)

    def ask(self, key: str, payload: bytes = b"", timeout_s: float | None = None) -> list[bytes]:
        """See `Bus.ask`."""
        self.machine.point()
        check_size(payload, MAX_MESSAGE_BYTES)
        self._raise_if_interrupted()
        network = self.network
        network.trace("asks", self.machine.name, key)
        question = _Question(self, key)
        for answer in network.declared("answer", key) if network.is_online(self) else []:
            question.num_open += 1
            self._pose(question, answer, bytes(payload), is_echo=False)
            if network.is_repeated():
                self._pose(question, answer, bytes(payload), is_echo=True)
        if not question.num_open:
            self.machine.sleep(network.delay_s())
        else:
            self._questions.append(question)
            limit_s = QUERY_TIMEOUT_S if timeout_s is None else timeout_s
            network.scheduler.park(question.waiters, limit_s)
            self._questions.remove(question)
        question.is_over = True
        self._raise_if_interrupted()
        for reply in question.replies:
            network.on_answer(self, key, reply)
        self.machine.point()
        return list(question.replies)

    def answer(self, key: str, callback: Callable[[Query], None]) -> Declaration:
        """See `Bus.answer`."""
        return self._declare("answer", key, callback)

    def watch_answered(self, key: str, callback: Callable[[bool], None]) -> Declaration:
        """See `Bus.watch_answered`."""
        return self._declare("watch_answered", key, lambda _, there: callback(there))

    def declare_alive(self, key: str) -> Declaration:
        """See `Bus.declare_alive`."""
        return self._declare("alive", key, lambda: None)

    def watch_alive(self, key: str, callback: Callable[[str, bool], None]) -> Declaration:
        """See `Bus.watch_alive`."""
        return self._declare("watch_alive", key, callback)

    def interrupt(self) -> None:
        """See `Bus.interrupt`."""
        self.machine.check()
        self._is_interrupted = True
        for question in list(self._questions):
            question.end()

    def close(self) -> None:
        """See `Bus.close`."""
        self.interrupt()
        self.network.leave(self)

    def cut(self) -> None:
        """The link to the router breaks."""
        self.has_link = False
        self.network.changed()

    def mend(self) -> None:
        """The link is back."""
        self.has_link = True
        self.network.changed()

    def deliver(self, call: Callable[[], object]) -> None:
        """Let something happen in the process, when it does not hang."""
        if self.machine.is_dead:
            return
        if self.machine.is_frozen:
            self._inbound.append(call)
        else:
            call()

    def thaw(self) -> None:
        """The process goes on: what has arrived meanwhile is delivered."""
        waiting, self._inbound = self._inbound, []
        for call in waiting:
            self.network.scheduler.after(1e-4, partial(self.deliver, call))

    def _pose(
        self, question: _Question, answer: Declaration, payload: bytes, is_echo: bool
    ) -> None:
        owner = answer.owner
        query = SimulatedQuery(question.key, payload, question, owner, is_echo)

        def hear() -> None:
            if answer in owner.declared:
                owner.asked.append(query)
                answer.call(query)
            else:
                query.end()

        def arrive() -> None:
            if self.network.is_online(owner):
                owner.deliver(hear)

        self.network.send(("ask", self.machine.name, question.key), arrive)

    def _declare(self, kind: str, key: str, callback: Callable[..., object]) -> Declaration:
        self.machine.check()
        if self not in self.network.members:
            raise BusClosed(f"cannot declare {key}: the bus is closed")
        declaration = Declaration(self, kind, key, callback)
        self.declared.append(declaration)
        self.network.changed()
        return declaration

    def _raise_if_interrupted(self) -> None:
        if self._is_interrupted:
            raise BusClosed("the bus is closed")


def _publish(subscription: Declaration, key: str, payload: bytes) -> Callable[[], object]:
    network = subscription.owner.network

    def arrive() -> None:
        if network.is_online(subscription.owner):
            subscription.call(key, payload)

    return arrive
