"""`covinz backup` and `covinz restore`: copies of a server's files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from covinz import backup

console = Console()
# The server's own processes go first.
NICENESS = 10

Data = Annotated[Path, typer.Option(help="Where the server keeps its files.", exists=True)]
NewData = Annotated[Path, typer.Option(help="Where the server keeps its files.")]


def back_up(
    folder: Annotated[Path, typer.Argument(help="New folder for the copy.")],
    data: Data = Path("data"),
) -> None:
    """Copy the files of a server while it runs; the copy is checked."""
    os.nice(NICENESS)
    made = backup.back_up(data, folder)
    size = sum(one.size_bytes for one in made.files.values())
    _say(f"{made.head} log entries, {size / 1e6:.1f} MB, in {folder}")


def restore(
    folder: Annotated[Path, typer.Argument(help="A backup.", exists=True, file_okay=False)],
    data: NewData = Path("data"),
    force: Annotated[
        bool, typer.Option("--force", help="Set aside what is there; without, nothing is done.")
    ] = False,
) -> None:
    """Bring a backup back, in the place of a stopped server's files."""
    made, aside = backup.restore(folder, data, force)
    for path in aside:
        _say(f"kept what was there: {path}")
    _say(f"{made.head} log entries of {made.created} are in {data}; the server may be started")


def _say(text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
