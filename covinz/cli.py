"""The `covinz` command."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Annotated

import numpy as np
import typer
import yaml
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from covinz import (
    cli_backup,
    cli_jobs,
    client,
    config,
    durable,
    evaluation,
    export,
    gaps,
    run,
    server_report,
    summary,
    supervisor,
    trajectory,
)
from covinz.access import commands as roster_commands
from covinz.access.roster import FOLDER
from covinz.access.server import server_bus
from covinz.backup import BackupError
from covinz.bus import BusError, open_router
from covinz.candidates import (
    LOOP,
    Candidate,
    CandidatesError,
    candidates,
    read_candidates,
    short_name,
)
from covinz.cli_doctor import doctor
from covinz.cli_spool import show_spool
from covinz.codec import MalformedMessage
from covinz.connection import CredentialsFile, Endpoint, connected
from covinz.keyframes import CameraNotFound, KeyframeNotFound, StoreUnavailable
from covinz.logs import LogFormat, set_up_logging
from covinz.saved_job import SavedJobError
from covinz.signals import stop_event
from covinz.spool import SpoolError

app = typer.Typer(
    help="Collaborative SLAM server: robots send keyframes, covinz puts them into one map.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(roster_commands.app, name="roster")
app.command("spool")(show_spool)
app.command("backup")(cli_backup.back_up)
app.command("restore")(cli_backup.restore)
app.command()(doctor)
app.add_typer(cli_jobs.app, name="jobs")
console = Console()
errors = Console(stderr=True)

ConfigFile = Annotated[
    Path | None, typer.Option("--config", help="YAML file with settings that differ.", exists=True)
]


@app.command()
def up(
    workers: Annotated[int, typer.Option(min=1, help="Loop-solver processes.")] = 1,
    data: Annotated[Path, typer.Option(help="Where the server keeps its files.")] = Path("data"),
    listen: Annotated[
        str | None,
        typer.Option(help="Address of this machine where the robots of the roster connect."),
    ] = None,
    config_file: ConfigFile = None,
    log_format: Annotated[
        LogFormat | None, typer.Option(help="How all processes log [text].")
    ] = None,
) -> None:
    """Start the server: router, ingest, place recognition, loop solvers, optimizer."""
    if log_format is not None:
        os.environ["COVINZ_LOG_FORMAT"] = log_format
    set_up_logging("up", "up")
    settings = config.load(config_file)
    bus = server_bus(settings.bus, data / FOLDER, listen)
    settings = settings.model_copy(update={"bus": bus})
    # What makes a server impossible is said here, once; its processes would be restarted for ever.
    open_router(settings.bus).close()
    durable.claim(data / "server")
    written = data / "config.yaml"
    written.write_text(yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False))
    specs = supervisor.server_specs(written.resolve(), data.resolve(), workers)
    stop = stop_event()
    with supervisor.Supervisor(specs, pid_file=data / "processes.json"):
        where = ", ".join(bus.listen or [bus.endpoint])
        _say(f"covinz listens on {where} ({workers} loop solvers)")
        _say(f"data in {data.resolve()}, Ctrl-C stops it")
        stop.wait()
        _say("stopping")


@app.command("run")
def run_scenario(
    scenario: Annotated[Path, typer.Argument(help="Scenario file.", exists=True, dir_okay=False)],
    workers: Annotated[int, typer.Option(min=1, help="Loop-solver processes.")] = 1,
    profile: Annotated[str, typer.Option(help="Solver profile: fast or paper.")] = "fast",
    rate: Annotated[
        float | None, typer.Option(min=0.01, help="Play at this multiple of real time.")
    ] = None,
    lockstep: Annotated[
        bool, typer.Option(help="Send in stamp order across agents: a reproducible run.")
    ] = False,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Instead of the scenario's: other paths and drift.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Run folder [default: runs/<name>-<time>].")
    ] = None,
) -> None:
    """Start a server, play a scenario's agents, evaluate, stop."""
    if rate is not None and lockstep:
        raise typer.BadParameter("--rate and --lockstep exclude each other")
    # Like Ctrl-C, SIGTERM must stop the server and the agents too.
    signal.signal(signal.SIGTERM, _leave)
    options = run.RunOptions(
        workers=workers, profile=profile, rate=rate, lockstep=lockstep, seed=seed, out=out
    )
    result = run.run_scenario(scenario, options, console)
    summary.show(console, result.report, result.folder, result.files)


@app.command()
def status(endpoint: Endpoint = None, credentials: CredentialsFile = None) -> None:
    """Show how far every process of a running server is."""
    with connected(endpoint, credentials) as bus:
        found = client.statuses(bus)
        if not found:
            raise client.ServerUnavailable("the router is there, but no process answers")
        now = client.progress(bus)
    table = Table("process", "cursor", "pending", "leased", "dirty", box=box.SIMPLE_HEAD)
    for item in found:
        numbers = (str(item.cursor), str(item.pending), str(item.leased))
        table.add_row(item.instance, *numbers, "yes" if item.dirty else "")
    console.print(table)
    for item in found:
        counters = "  ".join(f"{name}={value:g}" for name, value in sorted(item.counters.items()))
        if counters:
            console.print(f"[bold]{item.instance}[/]  {counters}", highlight=False)
    _say("idle" if now.idle else f"at work: {now}")


@app.command()
def why(
    keyframe: Annotated[str, typer.Argument(help="AGENT, AGENT/SEQ or AGENT/SESSION/SEQ.")],
    folder: Annotated[
        Path | None, typer.Option("--run", help="Ask a finished run's folder, not a server.")
    ] = None,
    endpoint: Endpoint = None,
    credentials: CredentialsFile = None,
) -> None:
    """Say for a keyframe which candidates it had and why each did or did not become a loop."""
    missing: list[str] = []
    if folder is not None:
        found = read_candidates(folder / "candidates.csv")
    else:
        with connected(endpoint, credentials) as bus:
            found = candidates(client.jobs(bus))
            missing = [gaps.in_words(g) for g in client.gaps(bus) if gaps.concerns(g, keyframe)]
    rows = [row for row in found if row.concerns(keyframe)]
    for line in missing:
        _say(line)
    if not rows:
        if not missing:
            _say(f"no candidate was ever found for {keyframe}")
        return
    console.print(_why_table(rows))


def _why_table(rows: Sequence[Candidate]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for heading in ("query", "candidate", "score", "outcome", "counted", "needed"):
        table.add_column(heading, no_wrap=True)
    table.add_column("detail")
    known = any(row.error_m for row in rows)
    if known:
        table.add_column("off by", no_wrap=True)
    for row in rows:
        colour = "green" if row.outcome == LOOP else "red" if row.counted else "default"
        off = f"{float(row.error_m):.2f} m {float(row.error_deg):.1f}°" if row.error_m else ""
        names = [short_name(name, rows) for name in (row.query, row.candidate)]
        words = [*names, row.score, f"[{colour}]{row.outcome}", *map(escape, row[4:7])]
        table.add_row(*words, *([off] if known else []))
    return table


@app.command("export")
def export_maps(
    out: Annotated[Path, typer.Option(help="Folder for the files.")] = Path("export"),
    endpoint: Endpoint = None,
    credentials: CredentialsFile = None,
) -> None:
    """Write the maps of a running server: TUM trajectories per agent and one g2o file a map."""
    with connected(endpoint, credentials) as bus:
        snapshots = client.snapshots(bus)
    for file in export.write_maps(out, snapshots):
        _say(str(file))


@app.command("report")
def report_server(
    scenario: Annotated[Path, typer.Argument(help="What was played.", exists=True, dir_okay=False)],
    played: Annotated[
        Path, typer.Option(help="Folder that the player left its summary, agents.json, in.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for report and pictures; without, as for run.")
    ] = None,
    endpoint: Endpoint = None,
    credentials: CredentialsFile = None,
    config_file: ConfigFile = None,
) -> None:
    """Evaluate a running server once it is idle, after robots were played from elsewhere."""
    settings = config.load(config_file)
    with connected(endpoint, credentials) as bus:
        result = server_report.report_server(bus, scenario, played, out, settings)
    summary.show(console, result.report, result.folder, result.files)


@app.command("eval")
def evaluate(
    groundtruth: Annotated[
        list[Path], typer.Option("--groundtruth", "-g", help="TUM file; one for all or one each.")
    ],
    estimates: Annotated[list[Path], typer.Argument(help="TUM files in one map frame.")],
) -> None:
    """Compare trajectories with ground truth: joint ATE (one alignment) and each alone."""
    if len(groundtruth) not in (1, len(estimates)):
        raise typer.BadParameter("give one ground truth, or one for each estimate")
    truths = groundtruth * len(estimates) if len(groundtruth) == 1 else groundtruth
    pairs = [
        evaluation.associate(trajectory.read_tum(estimate), trajectory.read_tum(truth))
        for estimate, truth in zip(estimates, truths, strict=True)
    ]
    headings = ("ATE alone [m]", "RPE over 1 m: median [m]", "[deg]")
    table = Table("trajectory", "poses", *map(escape, headings))
    for file, pair in zip(estimates, pairs, strict=True):
        if not len(pair):
            raise trajectory.TrajectoryError(f"{file}: no pose has ground truth at its time")
        rpe = evaluation.rpe_over_distance(pair, 1.0)
        medians = [_median(rpe.translation_m), _median(np.rad2deg(rpe.rotation_rad))]
        table.add_row(str(file), str(len(pair)), f"{evaluation.ate_m(pair):.4f}", *medians)
    console.print(table)
    _say(f"joint ATE, one SE(3) alignment: {evaluation.joint_ate_m(pairs):.4f} m")


def _leave(number: int, _: FrameType | None) -> None:
    """Signal handler: leave through all `finally` blocks, once."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)


def _say(text: str) -> None:
    """Print as it is: brackets are no markup, long lines are left to the terminal."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def _median(values: NDArray[np.float64]) -> str:
    return f"{np.median(values):.4f}" if len(values) else "-"


def main() -> None:
    """Entry point: known errors become one line, bugs keep their traceback."""
    # Who waits for the router says so in words of its own.
    logging.getLogger("covinz.bus").setLevel(logging.ERROR)
    known = (
        BackupError,
        BusError,
        CandidatesError,
        MalformedMessage,
        OSError,
        SpoolError,
        config.ConfigError,
        durable.DurableFileError,
        client.ServerUnavailable,
        KeyframeNotFound,
        CameraNotFound,
        StoreUnavailable,
        SavedJobError,
        supervisor.ServicesNotFound,
        run.RunFailed,
        trajectory.TrajectoryError,
    )
    try:
        app()
    except known as error:
        errors.print(f"covinz: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
