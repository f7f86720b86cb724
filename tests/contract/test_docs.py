"""The documentation tells the truth: paths, links, tests, options and keys that it names exist."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from covinz import config, keyexprs
from covinz.types import KeyframeId

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "schemas/*.md", "vocabulary/*.md")
    for path in ROOT.glob(pattern)
)
PAPER = (ROOT / "docs" / "paper.md").read_text()
EQUATIONS = PAPER.partition("## Equations")[2].partition("\n## ")[0]
OPTIONS = PAPER.partition("## Thresholds")[2].partition("\n## ")[0]
MESSAGES = (ROOT / "schemas" / "README.md").read_text()

CODE = re.compile(r"`([^`\n]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
FOLDERS = "agents|benchmarks|core|covinz|docs|schemas|scenarios|scripts|services|tests|vocabulary"
# `services/ingest/admission.py`, `schemas/*.fbs`, `vocabulary/`; not the key `covinz/loop`.
REPOSITORY_PATH = re.compile(rf"(?:{FOLDERS})/[\w./*-]*")
KEY = re.compile(r"covinz/(?:agent|camera|job|keyframe|log|loop|map|rejection|service)(?:/.*)?")
FILE_NAME = re.compile(r"[\w-]+\.(?:py|cc|h|md|fbs|yaml|bin|json|txt)")


def in_code(document: Path) -> Iterator[str]:
    """What stands in backticks, without the blocks of code."""
    prose = re.sub(r"^```.*?^```", "", document.read_text(), flags=re.MULTILINE | re.DOTALL)
    yield from CODE.findall(prose)


def exists(path: str) -> bool:
    """Whether files are where a document says, which abbreviates `core/include/covinz`."""
    header = re.sub(r"^core/", "core/include/covinz/", path)
    return any(ROOT.glob(path.rstrip("/"))) or any(ROOT.glob(header))


def named(documents: list[Path], pattern: re.Pattern[str]) -> list[tuple[str, str]]:
    """(document, text) of everything in backticks that is such a thing."""
    return [
        (str(document.relative_to(ROOT)), text)
        for document in documents
        for text in in_code(document)
        if pattern.fullmatch(text)
    ]


def sources() -> str:
    """Text of all tests of the core."""
    return "\n".join(path.read_text() for path in (ROOT / "core" / "tests").glob("*_test.cc"))


def test_paths_exist() -> None:
    found = [entry for entry in named(DOCUMENTS, REPOSITORY_PATH) if not KEY.fullmatch(entry[1])]
    assert len(found) > 50
    assert [entry for entry in found if not exists(entry[1])] == []


def test_files_named_without_a_folder_exist() -> None:
    made_by_users = {"rgb.txt", "calib.yaml", "calib.txt", "config.yaml", "report.json"}
    made_by_users |= {"sensor.yaml", "groundtruth.txt", "roster.yaml"}
    tracked = {
        path.name
        for folder in (ROOT / name for name in FOLDERS.split("|"))
        for path in folder.rglob("*")
    } | {path.name for path in ROOT.iterdir()}
    found = [entry for entry in named(DOCUMENTS, FILE_NAME) if entry[1] not in made_by_users]
    assert len(found) > 5
    assert [entry for entry in found if entry[1] not in tracked] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_resolve(document: Path) -> None:
    for link in LINK.findall(document.read_text()):
        if link.startswith(("http://", "https://")):
            continue
        file, _, anchor = link.partition("#")
        target = (document.parent / file).resolve() if file else document
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target.read_text()), link


def anchors(text: str) -> set[str]:
    """The fragments by which the headings of a document are linked."""
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings}


def in_column(table: str, column: int) -> list[str]:
    """What stands in backticks in a column (from 1) of a table."""
    rows = [line.split("|") for line in table.splitlines() if line.startswith("| ")]
    return [name for row in rows for name in CODE.findall(row[column])]


def test_tests_named_for_the_paper_exist() -> None:
    names = in_column(EQUATIONS, 3)
    assert len(names) > 20
    assert [name for name in names if not is_test(name)] == []


def is_test(name: str) -> bool:
    """A file or folder of tests, a test program of the core, or one of its tests."""
    if name.startswith("tests/"):
        return exists(name)
    if name.startswith("test_"):
        return any((ROOT / "tests").rglob(name))
    if name.endswith("_test"):
        return exists(f"core/tests/{name}.cc")
    case = name.rsplit(".", 1)[-1]
    return re.search(rf"\bTEST(?:_[FP])?\(\w+,\s*{re.escape(case)}\)", sources()) is not None


def test_options_named_for_the_paper_exist() -> None:
    """A section that is left out, as in `max_rig_iterations`, is that of the option before."""
    names = [name for name in in_column(OPTIONS, 3) if re.fullmatch(r"[a-z_.]+\*?", name)]
    assert len(names) > 10
    fields: set[str] = set()
    for name in names:
        section, _, option = name.rpartition(".")
        fields = config_fields(section) if section else fields
        start = option.removesuffix("*")
        assert any(f.startswith(start) if "*" in option else f == start for f in fields), name


def test_sections_named_for_the_paper_exist() -> None:
    """`...Config` is in covinz.config, `...Options` in the core; perhaps with a field."""
    pattern = r"(\w+(?:Config|Options))(?:\.(\w+))?"
    found = [match for name in CODE.findall(PAPER) if (match := re.fullmatch(pattern, name))]
    assert len(found) > 3
    headers = "\n".join(path.read_text() for path in (ROOT / "core/include").rglob("*.h"))
    for section, field in (match.groups() for match in found):
        if section.endswith("Config"):
            assert not field or field in getattr(config, section).model_fields, (section, field)
        else:
            body = re.search(rf"^struct {section} {{$(.*?)^}};$", headers, re.MULTILINE | re.DOTALL)
            assert body, section
            assert not field or re.search(rf"\b{field}( = .*)?;", body[1]), (section, field)


def config_fields(section: str) -> set[str]:
    """Names of the settings in a section, `optimizer` or `optimizer.odometry`."""
    model: type[BaseModel] = config.Config
    for name in section.split("."):
        below = model.model_fields[name].annotation
        assert below is not None
        assert issubclass(below, BaseModel)
        model = below
    return set(model.model_fields)


def test_functions_named_for_the_paper_exist() -> None:
    code = all_code()
    names = [
        name.rsplit(".", 1)[-1].rsplit("::", 1)[-1]
        for name in in_column(EQUATIONS, 2)
        if "/" not in name and re.fullmatch(r"[\w.:]+", name) and not FILE_NAME.fullmatch(name)
    ]
    assert len(names) > 15
    assert [name for name in names if not re.search(rf"\b{name}\b", code)] == []


def all_code() -> str:
    files = [
        path
        for folder in ("covinz", "services", "agents", "core/include", "core/src")
        for pattern in ("*.py", "*.h", "*.cc")
        for path in (ROOT / folder).rglob(pattern)
    ]
    return "\n".join(path.read_text() for path in files)


def test_the_guide_names_checks_that_reject() -> None:
    table = (ROOT / "docs" / "agents.md").read_text().partition("## Why is there no loop?")[2]
    stages = in_column(table.partition("\n## ")[0], 1)
    assert len(stages) > 5
    files = (
        "core/src/solve_loop.cc",
        "core/src/solve_loop_fast.cc",
        "services/loop_solver/solver.py",
    )
    solver = "".join((ROOT / file).read_text() for file in files)
    assert [stage for stage in stages if f'"{stage}"' not in solver] == []


BUILDERS = {
    name: function
    for name, function in inspect.getmembers(keyexprs, inspect.isfunction)
    if function.__module__ == keyexprs.__name__
    and not name.startswith("_")
    and not name.endswith("_of")
}


@pytest.mark.parametrize("name", sorted(BUILDERS))
def test_every_key_is_among_the_messages(name: str) -> None:
    """A built key, with the arguments' names in its places, stands in schemas/README.md."""
    places = {
        "agent": "a0", "worker": "w0", "map_id": "01ARZ3NDEKTSV4RRFFQ69G5FAV",
        "service": "ingest", "instance": "i0", "camera_hash": "c" * 64, "job_id": "d" * 32,
        "keyframe_id": KeyframeId("a0", "01ARZ3NDEKTSV4RRFFQ69G5FAV", 7),
    }  # fmt: skip
    builder = BUILDERS[name]
    key = builder(*(places[parameter] for parameter in inspect.signature(builder).parameters))
    documented = [text for text in CODE.findall(MESSAGES) if text.startswith("covinz/")]
    patterns = [re.sub(r"\\\{\w+\\\}", "[^/]+", re.escape(text)) for text in documented]
    assert any(re.fullmatch(pattern, key) for pattern in patterns), key


CONSTANTS = sorted(
    value
    for name, value in vars(keyexprs).items()
    if name.isupper() and isinstance(value, str) and value.startswith("covinz/")
)


@pytest.mark.parametrize("key", CONSTANTS)
def test_every_fixed_key_is_among_the_messages(key: str) -> None:
    documented = [text for text in CODE.findall(MESSAGES) if text.startswith("covinz/")]
    assert key in {re.sub(r"\{\w+\}", "*", text) for text in documented}
