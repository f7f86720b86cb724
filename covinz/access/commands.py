"""``covinz roster``: who may connect to a server."""

from __future__ import annotations

import sys
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from covinz.access import enrolment
from covinz.access.credentials import SUFFIX, write_secret
from covinz.access.enrolment import Request
from covinz.access.roster import FOLDER, Roster

app = typer.Typer(
    help="Who may connect to a server: robots, and people who look at it.", no_args_is_help=True
)
console = Console()

Data = Annotated[Path, typer.Option(help="Where the server keeps its files.")]
Folder = Annotated[
    Path | None,
    typer.Option(
        "--roster", help="The roster's folder [DATA/roster].", envvar="COVINZ__BUS__ROSTER"
    ),
]
Name = Annotated[str, typer.Argument(help="The robot's agent id.")]


class Transport(StrEnum):
    """How a robot connects."""

    TLS = "tls"
    QUIC = "quic"


@app.command()
def add(
    name: Name,
    host: Annotated[
        str | None, typer.Option("--server", help="Name or address where it reaches the server.")
    ] = None,
    port: Annotated[int | None, typer.Option(help="The server's port [7447].")] = None,
    transport: Annotated[
        Transport, typer.Option(help="quic keeps going where Wi-Fi loses packets.")
    ] = Transport.TLS,
    days: Annotated[int, typer.Option(min=1, help="Its credentials expire after so many.")] = 730,
    operator: Annotated[
        bool, typer.Option(help="Not a robot: may read and change everything.")
    ] = False,
    replace: Annotated[
        bool, typer.Option(help="New credentials for a known name; the old ones are void.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="File to write, - prints [NAME.covinz].")] = None,
    data: Data = Path("data"),
    roster: Folder = None,
) -> None:
    """Let a robot in, and write the one file that it needs."""
    wanted = Request(
        name=name,
        role="server" if operator else "agent",
        host=host,
        port=port,
        transport=transport.value,
        lifetime=timedelta(days=days),
        replace=replace,
    )
    target = out or Path(f"{name}{SUFFIX}")
    folder = _roster(data, roster)
    made = enrolment.add(folder, wanted)
    if str(target) == "-":
        sys.stdout.write(made.text())
        return
    try:
        write_secret(target, made.text())
    except OSError:
        enrolment.remove(folder, name)
        raise
    _say(f"{name} may connect to {made.endpoint} until {made.until:%Y-%m-%d}")
    _say(f"its credentials: {target}; give it to {name} alone, they are secret and not kept here")


@app.command()
def remove(name: Name, data: Data = Path("data"), roster: Folder = None) -> None:
    """Let a robot in no longer; a server that runs ends its connection within seconds."""
    enrolment.remove(_roster(data, roster), name)
    _say(f"{name} may not connect any more; a server that runs follows within seconds")


@app.command("list")
def show(data: Data = Path("data"), roster: Folder = None) -> None:
    """Show who may connect, and until when."""
    content = _roster(data, roster).read()
    table = Table("name", "may", "until", "", box=box.SIMPLE_HEAD)
    for name, member in sorted(content.members.items()):
        left = (member.until - datetime.now(UTC)).days
        state = "[red]expired[/]" if left < 0 else f"{left} days"
        may = "everything" if member.role == "server" else "send, be corrected"
        table.add_row(name, may, f"{member.until:%Y-%m-%d}", state)
    console.print(table)
    _say(f"at {', '.join(content.hosts)}, port {content.port}")


def _roster(data: Path, roster: Path | None) -> Roster:
    return Roster(data / FOLDER if roster is None else roster)


def _say(text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
