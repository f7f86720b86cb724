"""What ingest has seen of one robot: why does nothing of it arrive, or nothing come of it?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from covinz.doctor.clocks import MAX_OFFSET_S
from covinz.doctor.findings import Finding, Verdict
from covinz.plausibility import ADVICE
from covinz.types import Status

# A robot that drives sends more often. [s]
QUIET_S = 60.0
# Stamps that are older come from a recording, or are not Unix time. [s]
RECORDED_S = 86400.0
# Keyframes of which so many are affected have it as a rule.
RULE = 0.5
# A few tell nothing.
MIN_KEYFRAMES = 10

# By code of `services/ingest/admission.py`.
REFUSALS: Mapping[str, str] = {
    "bad_key": "upload with covinz.Agent; other programs find the keys in schemas/README.md",
    "too_large": "send fewer features or a smaller thumbnail, or raise ingest.max_upload_bytes",
    "malformed": "the program is broken or far newer than the server: upgrade the server",
    "foreign_agent": "the program sends under another name than its credentials",
    "bad_seq": "sequence numbers count from 0 in each session",
    "no_features": "send the keypoints and descriptors with each keyframe",
    "too_many_features": "send fewer features, or raise ingest.max_features",
    "keypoint_outside": "the calibration is of another image size than the images, or keypoints "
    "are not in raw pixels",
    "too_many_cameras": "register each calibration once, do not change it while driving; or raise "
    "ingest.max_cameras_per_agent",
    "long_reason": "shorten the reason of the gap",
    "conflict": "two programs send as this robot, or a spool was copied: give each credentials of "
    "its own, and start one of them with an empty spool",
}


def of_agent(agent: str, seen: Status) -> Iterator[Finding]:
    """What is wrong with what came of a robot since ingest was started.

    Args:
        agent: The robot.
        seen: The answer at `keyexprs.agent_status`.
    """
    counters = seen.counters
    for code, count in _family(counters, "rejected"):
        yield Finding(
            Verdict.BAD,
            f"{agent}: {count:g} uploads refused: {code}",
            REFUSALS.get(code, "ingest's log says why"),
        )
    for code, _ in _family(counters, "odd_calibration"):
        advice = ADVICE.get(code, "see covinz doctor --calibration")
        yield Finding(Verdict.ODD, f"{agent}: its calibration is odd: {code}", advice)
    if not counters.get("keyframes"):
        yield Finding(
            Verdict.ODD,
            f"{agent}: no keyframe has come since ingest was started",
            "is its program running? Its log names what it waits for; a robot that stands still "
            "makes no keyframes",
        )
        return
    yield from _arrival(agent, counters)
    yield from _content(agent, counters)


def _arrival(agent: str, counters: Mapping[str, float]) -> Iterator[Finding]:
    quiet_s, age_s = counters["since_last_keyframe_s"], counters["youngest_keyframe_s"]
    verdict = Verdict.ODD if quiet_s > QUIET_S else Verdict.GOOD
    advice = "it stands still, is switched off, or has lost its network: see its log"
    yield Finding(
        verdict,
        f"{agent}: the last keyframe came {quiet_s:.0f} s ago",
        advice if verdict is Verdict.ODD else "",
    )
    if age_s < -MAX_OFFSET_S:
        yield Finding(
            Verdict.ODD,
            f"{agent}: its stamps are {-age_s:.1f} s in the future",
            "its clock is ahead of the server's: let both follow the same time (NTP, chrony)",
        )
    elif age_s > RECORDED_S:
        yield Finding(
            Verdict.ODD,
            f"{agent}: its stamps are {age_s / 86400:.0f} days old",
            "right for a recording; else its clock is wrong, or stamps are not in nanoseconds "
            "since the Unix epoch",
        )
    elif age_s > MAX_OFFSET_S:
        yield Finding(
            Verdict.ODD,
            f"{agent}: even the quickest of its last keyframes came {age_s:.1f} s after its stamp",
            "its clock is behind the server's, or its network is too slow for what it sends",
        )


def _content(agent: str, counters: Mapping[str, float]) -> Iterator[Finding]:
    keyframes = counters["keyframes"]
    if back := counters.get("stamps_back", 0.0):
        yield Finding(
            Verdict.ODD,
            f"{agent}: {back:g} keyframes have an older stamp than the one before",
            "stamp with one clock, and begin a new session when the odometry starts over",
        )
    if keyframes < MIN_KEYFRAMES:
        return
    if (few := counters.get("few_features", 0.0)) > RULE * keyframes:
        yield Finding(
            Verdict.BAD,
            f"{agent}: {few:g} of {keyframes:g} keyframes have too few features to be looked up",
            "is the lens covered, the image dark, or the threshold of the detector too high?",
        )
    if (still := counters.get("still", 0.0)) > RULE * keyframes:
        yield Finding(
            Verdict.ODD,
            f"{agent}: {still:g} of {keyframes:g} keyframes have not moved since the one before",
            "without motion there is no scale, so no loop: make keyframes by distance, and check "
            "that the odometry is alive and in metres",
        )
    if (sessions := counters.get("sessions", 0.0)) > keyframes / 5:
        yield Finding(
            Verdict.ODD,
            f"{agent}: {sessions:g} sessions for {keyframes:g} keyframes",
            "its odometry or its program starts over all the time",
        )


def _family(counters: Mapping[str, float], name: str) -> list[tuple[str, float]]:
    """What follows ``{name}.`` in the counters' names, and their values."""
    return [
        (key.removeprefix(f"{name}."), value)
        for key, value in sorted(counters.items())
        if key.startswith(f"{name}.") and value
    ]
