"""The fuzzer: spoils messages, has them read, and keeps those that reach new code.

One thread, one generator: a seed is the same run every time, to the last byte.

Source: coverage-guided mutation as in AFL (Zalewski, "Technical whitepaper for afl-fuzz", 2014),
with the line that refused an input, and the lines that led there, in place of branch coverage.
"""

from __future__ import annotations

import time
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random
from types import TracebackType
from typing import Any

from covinz.codec import MalformedMessage
from tests.fuzz.anatomy import Anatomy, dissect
from tests.fuzz.mutations import mutate
from tests.fuzz.readers import READERS, Reader, send_on

# The CPU time that one message may take, as refused hangs: far above what the largest takes. [s]
MAX_CPU_S = 0.5
# What reading may allocate at most: some fixed costs, and a multiple of the message.
MAX_PEAK_BYTES, MAX_PEAK_PER_BYTE = 1 << 17, 64
# Memory is traced for one in so many messages, and one in so many accepted ones is sent on.
TRACE_EVERY, SEND_EVERY = 512, 8
# Inputs kept for a message type; beyond it new ones take the places of old ones.
MAX_KEPT = 400

# Where an input ended: the message type, and the lines on the way to the error (none: accepted).
Ending = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Specimen:
    """An input to mutate: a good message, or one that reached new code."""

    payload: bytes
    parts: Anatomy


@dataclass(frozen=True, slots=True)
class Finding:
    """An input that did what none may do."""

    what: str
    message: str
    payload: bytes


@dataclass(slots=True)
class Tally:
    """What a run came to."""

    decodes: int = 0
    accepted: int = 0
    by_message: Counter[str] = field(default_factory=Counter)
    by_mutation: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    most_peak_bytes: int = 0
    most_peak_per_byte: float = 0.0
    findings: list[Finding] = field(default_factory=list)


class Fuzzer:
    """Decodes mutated messages of every type.

    Args:
        seeds: Good messages, each under the name of its type.
        seed: Of the generator.
        readers: What reads messages, by the type that is expected.

    Attributes:
        tally: So far.
        corpus: The shortest input found so far that ended where it did.
    """

    def __init__(
        self,
        seeds: Iterable[tuple[str, bytes]],
        seed: int,
        readers: Mapping[str, Sequence[Reader]] = READERS,
    ) -> None:
        self._rng = Random(seed)
        self._readers = readers
        self._pool: dict[str, list[Specimen]] = {}
        for name, payload in seeds:
            self._pool.setdefault(name, []).append(Specimen(payload, dissect(payload)))
        self._num_seeds = {name: len(pool) for name, pool in self._pool.items()}
        self._names = sorted(self._pool)
        self.tally = Tally()
        self.corpus: dict[Ending, tuple[str, bytes]] = {}

    def run(self, decodes: int, stop: Callable[[], bool] = lambda: False) -> None:
        """Decode so many messages, or until `stop`, asked now and then, says so."""
        for number in range(decodes):
            if number % 256 == 255 and stop():
                return
            self._one()

    def _one(self) -> None:
        rng, tally = self._rng, self.tally
        name = rng.choice(self._names)
        specimen = self._draw(name)
        other = self._draw(name if rng.random() < 0.5 else rng.choice(self._names))
        payload, done = mutate(rng, specimen.payload, specimen.parts, other.payload)
        reader = rng.choice(self._readers[name])
        is_traced = tally.decodes % TRACE_EVERY == 0
        ending = self._read(reader, name, payload, is_traced)
        tally.decodes += 1
        tally.by_message[name] += 1
        tally.by_mutation.update([mutation.__name__ for mutation in done])
        if self._is_new(ending, name, payload):
            self._keep(name, Specimen(payload, specimen.parts))

    def _is_new(self, ending: Ending, name: str, payload: bytes) -> bool:
        known = self.corpus.get(ending)
        if known is None or len(payload) < len(known[1]):
            self.corpus[ending] = (name, payload)
        return known is None

    def learn(self, name: str, payload: bytes) -> None:
        """Take in an input that an earlier run kept; it counts as no decode."""
        specimen = Specimen(payload, self._pool[name][0].parts)
        for reader in self._readers[name]:
            if self._is_new(self._read(reader, name, payload, is_traced=False), name, payload):
                self._keep(name, specimen)

    def _draw(self, name: str) -> Specimen:
        """Every other time a good message: most mutations of a bad one change nothing."""
        pool = self._pool[name]
        if self._rng.random() < 0.5:
            return pool[self._rng.randrange(self._num_seeds[name])]
        return self._rng.choice(pool)

    def _keep(self, name: str, specimen: Specimen) -> None:
        pool = self._pool[name]
        if len(pool) < MAX_KEPT:
            pool.append(specimen)
        else:  # never in the place of a good message
            pool[self._rng.randrange(self._num_seeds[name], len(pool))] = specimen

    def _read(self, reader: Reader, name: str, payload: bytes, is_traced: bool) -> Ending:
        """Have it read; returns where that ended."""
        tally = self.tally
        if is_traced:
            tracemalloc.start()
        began_s = time.thread_time()
        ending: Ending = (name,)
        try:
            value = reader(payload)
        except MalformedMessage as error:
            ending += tuple(_lines(error))
        except Exception as error:  # the one thing that must not be
            tally.findings.append(Finding(repr(error), name, payload))
        else:
            tally.accepted += 1
            ending += (type(value).__name__,)
            if tally.accepted % SEND_EVERY == 0:
                self._send_on(value, name, payload)
        lasted_s = time.thread_time() - began_s
        tally.slowest_s = max(tally.slowest_s, lasted_s)
        if lasted_s > MAX_CPU_S:
            tally.findings.append(Finding(f"took {lasted_s:.2f} s", name, payload))
        if is_traced:
            self._note_memory(name, payload)
        return ending

    def _send_on(self, value: Any, name: str, payload: bytes) -> None:
        try:
            send_on(value)
        except Exception as error:
            self.tally.findings.append(Finding(f"accepted, but {error!r}", name, payload))

    def _note_memory(self, name: str, payload: bytes) -> None:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        tally = self.tally
        tally.most_peak_bytes = max(tally.most_peak_bytes, peak)
        if len(payload) >= 1024:
            tally.most_peak_per_byte = max(tally.most_peak_per_byte, peak / len(payload))
        if peak > MAX_PEAK_BYTES + MAX_PEAK_PER_BYTE * len(payload):
            self.tally.findings.append(Finding(f"allocated {peak} bytes", name, payload))


def _lines(error: BaseException | None) -> Iterable[int]:
    """Line numbers from the reader to where it was raised, and of what that was made from."""
    while error is not None:
        trace: TracebackType | None = error.__traceback__
        while trace is not None:
            yield trace.tb_lineno
            trace = trace.tb_next
        error = error.__cause__
