"""Log lines for people and for programs."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Iterator

import pytest

from covinz.logs import LogFormat, about, set_up_logging
from covinz.types import KeyframeId

KEYFRAME = KeyframeId("a1", "01ARZ3NDEKTSV4RRFFQ69G5FAV", 7)


@pytest.fixture
def root_logger() -> Iterator[logging.Logger]:
    root = logging.getLogger()
    level, handlers = root.level, root.handlers[:]
    root.handlers = []
    yield root
    root.setLevel(level)
    root.handlers = handlers


@pytest.mark.parametrize(
    ("level", "expected"),
    [("debug", logging.DEBUG), ("WARNING", logging.WARNING), ("nonsense", logging.INFO)],
)
def test_the_environment_sets_the_level(
    root_logger: logging.Logger,
    capfd: pytest.CaptureFixture[str],
    level: str,
    expected: int,
) -> None:
    set_up_logging("ingest", "ingest-2", level)
    assert root_logger.level == expected
    logging.getLogger("covinz.test").error("one %s", "line")
    last = capfd.readouterr().err.splitlines()[-1]
    assert last.endswith("ERROR   ingest-2 covinz.test: one line")
    set_up_logging("ingest", "b", level)
    logging.getLogger("covinz.test").error("x")
    assert " ingest/b covinz.test: x" in capfd.readouterr().err


def json_line(capfd: pytest.CaptureFixture[str]) -> dict[str, str]:
    (line,) = capfd.readouterr().err.splitlines()
    made: dict[str, str] = json.loads(line)
    return made


def test_a_json_line_says_who_when_and_what(
    root_logger: logging.Logger, capfd: pytest.CaptureFixture[str]
) -> None:
    set_up_logging("ingest", "ingest-2", "INFO", LogFormat.JSON)
    logging.getLogger("covinz.test").warning("one %s", 'with "quotes"\nand lines')
    line = json_line(capfd)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", line.pop("time"))
    assert line == {
        "level": "WARNING",
        "service": "ingest",
        "instance": "ingest-2",
        "logger": "covinz.test",
        "message": 'one with "quotes"\nand lines',
    }


def test_a_json_line_says_what_it_is_about(
    root_logger: logging.Logger, capfd: pytest.CaptureFixture[str]
) -> None:
    set_up_logging("ingest", "ingest", "INFO", LogFormat.JSON)
    logging.getLogger("covinz.test").info("x", extra=about(keyframe=KEYFRAME, job="j1"))
    line = json_line(capfd)
    assert (line["agent"], line["keyframe"], line["job"]) == ("a1", str(KEYFRAME), "j1")
    logging.getLogger("covinz.test").info("x", extra=about(agent="a2"))
    line = json_line(capfd)
    assert line["agent"] == "a2" and not {"keyframe", "job"} & line.keys()


def test_a_traceback_stays_in_its_json_line(
    root_logger: logging.Logger, capfd: pytest.CaptureFixture[str]
) -> None:
    set_up_logging("ingest", "ingest", "INFO", LogFormat.JSON)
    try:
        raise ZeroDivisionError("a bug")
    except ZeroDivisionError:
        logging.getLogger("covinz.test").exception("failed")
    assert json_line(capfd)["error"].endswith("ZeroDivisionError: a bug")


@pytest.mark.parametrize(("form", "is_json"), [("JSON", True), ("text", False), ("xml", False)])
def test_the_environment_sets_the_format(
    root_logger: logging.Logger,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    form: str,
    is_json: bool,
) -> None:
    monkeypatch.setenv("COVINZ_LOG_FORMAT", form)
    set_up_logging("ingest", "ingest")
    logging.getLogger("covinz.test").info("x")
    said = capfd.readouterr().err
    assert said.startswith("{") == is_json
    assert ("neither text nor json" in said) == (form == "xml")
