"""The message bus: what every process needs of Zenoh, and the only package that imports it.

`Bus` is the protocol that the rest of covinz is written against. `ZenohBus` is the real one;
`covinz.memory_bus.InMemoryBus` plays it in unit tests. `open_router` is the hub in the middle.
"""

from covinz.bus.diagnosis import why_not
from covinz.bus.protocol import (
    Bus,
    BusClosed,
    BusError,
    Closable,
    MessageTooLarge,
    Query,
    check_size,
)
from covinz.bus.router import Router, open_router
from covinz.bus.session import ZenohBus

__all__ = [
    "Bus",
    "BusClosed",
    "BusError",
    "Closable",
    "MessageTooLarge",
    "Query",
    "Router",
    "ZenohBus",
    "check_size",
    "open_router",
    "why_not",
]
