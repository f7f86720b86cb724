"""Answers of ingest to an upload."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Stored:
    """The upload is durable."""


@dataclass(frozen=True, slots=True)
class Duplicate:
    """The same upload was durable already; for the agent as good as Stored."""


@dataclass(frozen=True, slots=True)
class RetryAfter:
    """Overloaded or not ready: send again after `seconds`."""

    seconds: float
    reason: str


@dataclass(frozen=True, slots=True)
class NeedCamera:
    """The keyframe names a calibration that is not registered: send it, then send again."""

    camera_hash: str


@dataclass(frozen=True, slots=True)
class Rejected:
    """The upload can never be accepted; the only final refusal.

    Attributes:
        code: Short snake_case name of the check that failed, e.g. ``foreign_agent``.
        reason: What was wrong, for a person.
    """

    code: str
    reason: str


UploadReply = Stored | Duplicate | RetryAfter | NeedCamera | Rejected
