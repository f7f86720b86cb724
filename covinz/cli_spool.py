"""`covinz spool`: what a robot's spool holds, what the server refused, and sending that again."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from covinz import durable, spool_rows
from covinz.config import AgentConfig
from covinz.dead_letters import DeadLetter, DeadLetters
from covinz.spool import Spool, SpoolError, SpoolReport

console = Console()


def show_spool(
    file: Annotated[
        Path, typer.Argument(help="Spool of a robot, e.g. robot-1.sqlite.", exists=True)
    ],
    again: Annotated[
        bool, typer.Option("--again", help="Send what the server refused once more.")
    ] = False,
) -> None:
    """Show what waits in a robot's spool and what the server refused, on the robot."""
    agent, report = look(file)
    if again:
        spool = Spool(file, agent, AgentConfig())
        try:
            count = spool.send_again()
        finally:
            spool.close()
        _say(f"{count} keyframes go with the next run of {agent}")
        return
    _say(f"{agent}: {report.pending} uploads wait, {report.bytes / 1e6:.1f} MB")
    _say(f"given up so far: {report.dropped} keyframes; refused by the server: {report.rejected}")
    kept = DeadLetters(Path(f"{file}.rejected"), 0)
    if letters := kept.letters():
        console.print(_table(letters))
        _say(f"their messages are in {kept.folder}; --again sends the keyframes once more")


def look(file: Path) -> tuple[str, SpoolReport]:
    """Whose spool it is and what it holds, also while the robot uses it.

    Raises:
        SpoolError: If it is not a spool.
    """
    wanted = int.from_bytes(spool_rows.SPOOL_FILE.application_id, "big")
    try:
        with closing(durable.open_reader(file)) as db:
            if db.execute("PRAGMA application_id").fetchone() != (wanted,):
                raise SpoolError(f"{file} is not a spool")
            agent, dropped, rejected = db.execute(
                "SELECT agent, dropped, rejected FROM owner"
            ).fetchone()
            return agent, SpoolReport(*spool_rows.usage(db), dropped, rejected)
    except sqlite3.Error as error:
        raise SpoolError(f"cannot read {file} as a spool: {error}") from error


def _table(letters: list[DeadLetter]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("refused at", "what", "code"):
        table.add_column(heading, no_wrap=True)
    table.add_column("reason", overflow="fold")
    for letter in letters:
        what = f"{letter.session}/{letter.first_seq}" + (" (gap)" if letter.is_gap else "")
        table.add_row(letter.refused_at[:19], what, letter.code, escape(letter.reason))
    return table


def _say(text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
