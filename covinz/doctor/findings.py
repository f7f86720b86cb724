"""What was looked at, and what it means."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """What a finding means."""

    GOOD = "good"
    ODD = "odd"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at, in words for a person.

    Attributes:
        verdict: What it means.
        text: What was seen.
        advice: What to do; empty where there is nothing to do.
    """

    verdict: Verdict
    text: str
    advice: str = ""


def is_well(findings: Iterable[Finding]) -> bool:
    """Whether nothing was found that keeps keyframes from arriving or loops from being found."""
    return all(finding.verdict is not Verdict.BAD for finding in findings)
