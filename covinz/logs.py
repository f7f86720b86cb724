"""Log lines of a process: text for people, or one JSON object a line for programs.

A JSON line has ``time`` (UTC), ``level``, ``service``, ``instance``, ``logger``, ``message``;
``error`` with a traceback; and ``agent``, ``keyframe``, ``job`` where the event is about one.
"""

from __future__ import annotations

import json
import logging
import os
import time
from enum import StrEnum

from covinz.types import KeyframeId

logger = logging.getLogger(__name__)

# What an event may be about: given with `about`.
FIELDS = ("agent", "keyframe", "job")


class LogFormat(StrEnum):
    """How log lines are written."""

    TEXT = "text"
    JSON = "json"


def about(
    agent: str | None = None, keyframe: KeyframeId | None = None, job: str | None = None
) -> dict[str, str]:
    """What an event is about, for ``logger.info(..., extra=about(...))``."""
    if keyframe is not None and agent is None:
        agent = keyframe.agent
    given = {"agent": agent, "keyframe": None if keyframe is None else str(keyframe), "job": job}
    return {name: text for name, text in given.items() if text is not None}


def set_up_logging(
    name: str, instance: str, level: str | None = None, form: LogFormat | None = None
) -> None:
    """Log one line an event to standard error, in UTC.

    Args:
        name: Kind of process.
        instance: Which one of several.
        level: Name of the lowest level that is logged; default: ``COVINZ_LOG``, else INFO.
        form: How; default: ``COVINZ_LOG_FORMAT``, else text.
    """
    level = (level or os.environ.get("COVINZ_LOG", "INFO")).upper()
    wanted = form or os.environ.get("COVINZ_LOG_FORMAT", LogFormat.TEXT).lower()
    is_json = wanted == LogFormat.JSON
    handler = logging.StreamHandler()
    handler.setFormatter(_JsonLines(name, instance) if is_json else _text(name, instance))
    known = logging.getLevelNamesMapping()
    logging.basicConfig(level=known.get(level, logging.INFO), handlers=[handler], force=True)
    if level not in known:
        logger.warning("COVINZ_LOG=%s is not a level; using INFO", level)
    if wanted not in tuple(LogFormat):
        logger.warning("COVINZ_LOG_FORMAT=%s is neither text nor json; using text", wanted)


def _text(name: str, instance: str) -> logging.Formatter:
    who = instance if instance.startswith(name) else f"{name}/{instance}"
    formatter = logging.Formatter(
        f"%(asctime)s.%(msecs)03dZ %(levelname)-7s {who} %(name)s: %(message)s",
        datefmt="%Y-%m-%dT%H:%M:%S",
    )
    formatter.converter = time.gmtime
    return formatter


class _JsonLines(logging.Formatter):
    """One JSON object an event, in one line."""

    def __init__(self, service: str, instance: str) -> None:
        super().__init__()
        self._service = service
        self._instance = instance

    def format(self, record: logging.LogRecord) -> str:
        seconds = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        line: dict[str, str] = {
            "time": f"{seconds}.{int(record.msecs):03d}Z",
            "level": record.levelname,
            "service": self._service,
            "instance": self._instance,
            "logger": record.name,
            "message": record.getMessage(),
        }
        line |= {name: str(record.__dict__[name]) for name in FIELDS if name in record.__dict__}
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        return json.dumps(line, ensure_ascii=False)
