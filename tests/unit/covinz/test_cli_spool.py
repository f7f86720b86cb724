"""`covinz spool` on a robot: what waits, what was refused, and once more."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from covinz import cli, codec
from covinz.config import AgentConfig
from covinz.spool import Spool
from covinz.spool_rows import SpoolEntry
from covinz.types import KeyframeId, Rejected
from tests.uploads import CAMERA, SESSION, message


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    cli.app(["spool", *arguments], standalone_mode=False)
    return " ".join(capsys.readouterr().out.split())


def made(file: Path) -> Spool:
    spool = Spool(file, "a0", AgentConfig())
    for seq in range(3):
        name = KeyframeId("a0", SESSION, seq)
        entry = SpoolEntry(name, seq, message(seq), CAMERA.hash, codec.encode(CAMERA))
        spool.append([entry])
    row = spool.take()
    assert row is not None
    spool.rejected(row.position, Rejected("too_large", "more than [1] byte"))
    return spool


def test_it_shows_a_spool_in_use(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spool = made(tmp_path / "a0.sqlite")
    said = run(capsys, str(tmp_path / "a0.sqlite"))
    assert "a0: 3 uploads wait" in said
    assert "given up so far: 0 keyframes; refused by the server: 1" in said
    assert f"{SESSION}/0" in said and "too_large" in said
    spool.close()


def test_refused_keyframes_go_with_the_next_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a0.sqlite"
    made(file).close()
    assert "1 keyframes go with the next run of a0" in run(capsys, str(file), "--again")
    spool = Spool(file, "a0", AgentConfig())
    assert (len(spool), spool.rejections()) == (4, [])
    spool.close()


@pytest.mark.parametrize("content", [b"", b"not a database at all, but long enough" * 100])
def test_another_file(
    tmp_path: Path,
    content: bytes,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    file = tmp_path / "a0.sqlite"
    file.write_bytes(content)
    monkeypatch.setattr(sys, "argv", ["covinz", "spool", str(file)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 1
    assert "spool" in capsys.readouterr().err
