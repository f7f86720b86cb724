"""``covinz jobs``: what the server gave up, and trying it again."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from covinz import client, codec, config, keyexprs, supervisor
from covinz.bus import Bus
from covinz.connection import CredentialsFile, Endpoint, connected
from covinz.keyframes import RemoteKeyframeStore
from covinz.saved_job import gather, saved_job_path, write_saved_job
from covinz.types import JobRecord, JobState, Rejected, Rejection

app = typer.Typer(help="Jobs that the server gave up: which, why, and once more.")
console = Console()

GIVEN_UP = ("dead_letter", "shed")
Data = Annotated[Path, typer.Option(help="Where the server keeps its files.")]


@app.callback(invoke_without_command=True)
def dead(
    context: typer.Context, endpoint: Endpoint = None, credentials: CredentialsFile = None
) -> None:
    """List the jobs that were given up, with the reason."""
    if context.invoked_subcommand is not None:
        return
    with connected(endpoint, credentials) as bus:
        records = list(client.jobs(bus))
    given_up = [record for record in records if _stage(record) in GIVEN_UP]
    if given_up:
        console.print(_table(given_up))
    open_jobs = sum(record.outcome is None for record in records)
    _say(f"{len(given_up)} of {len(records)} jobs given up, {open_jobs} open")


@app.command()
def replay(
    job: Annotated[str, typer.Argument(help="Id of the job, or the file with its input.")],
    data: Data = Path("data"),
    timeout_s: Annotated[float, typer.Option("--timeout", help="End it after so long. [s]")] = 60.0,
    requeue: Annotated[
        bool, typer.Option("--requeue", help="Let the server's loop solvers try it again, too.")
    ] = False,
    endpoint: Endpoint = None,
    credentials: CredentialsFile = None,
) -> None:
    """Solve a job once more, here and in a process of its own, and say what comes of it."""
    file = Path(job) if Path(job).is_file() else saved_job_path(data, job)
    if not file.is_file():
        with connected(endpoint, credentials) as bus:
            _fetch(bus, job, file)
        _say(f"input saved in {file}")
    verdict = _solve(file, timeout_s)
    if verdict:
        _say(verdict)
    if requeue:
        with connected(endpoint, credentials) as bus:
            _requeue(bus, file.stem)
        _say(f"job {file.stem} waits for a loop solver again")
    if verdict:
        sys.exit(1)


def _fetch(bus: Bus, job_id: str, file: Path) -> None:
    """Make the file with a job's input from what the server has."""
    found = [record.job for record in client.jobs(bus) if record.job.id == job_id]
    if not found:
        raise client.ServerUnavailable(f"there is no {file}, and the server knows no job {job_id}")
    settings = config.load(None).loop_solver
    write_saved_job(file, gather(found[0], settings, RemoteKeyframeStore(bus, 64)))


def _solve(file: Path, timeout_s: float) -> str:
    """What was wrong with the process that solved it; empty when nothing was."""
    command = [sys.executable, "-m", "services.loop_solver.replay", str(file.resolve())]
    supervisor.require_services()
    try:
        code = subprocess.run(
            command,
            cwd=supervisor.checkout(),
            env=supervisor.child_environment(),
            timeout=timeout_s,
            check=False,
        ).returncode
    except subprocess.TimeoutExpired:
        return f"it hangs: no outcome after {timeout_s:g} s"
    if code < 0:
        return f"the solver was killed by signal {-code}"
    return f"the solver failed with code {code}" if code else ""


def _requeue(bus: Bus, job_id: str) -> None:
    replies: Sequence[bytes] = bus.ask(keyexprs.job_retry(job_id))
    if not replies:
        raise client.ServerUnavailable("place_recognition does not answer")
    answer = codec.decode_upload_reply(replies[0])
    if isinstance(answer, Rejected):
        raise client.ServerUnavailable(f"the server does not take it: {answer.reason}")


def _table(records: Sequence[JobRecord]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for heading in ("job", "query", "candidate", "stage", "counted", "limit", "reason"):
        table.add_column(heading, no_wrap=heading != "reason", overflow="fold")
    for record in records:
        if isinstance(record.outcome, Rejection):
            reason = record.outcome
            figures = (f"{reason.count:g}", f"{reason.threshold:g}")
            names = (record.job.id, str(record.job.query), str(record.job.cand))
            table.add_row(*names, reason.stage, *figures, reason.detail)
    return table


def _stage(record: JobRecord) -> str:
    is_over = record.state in (JobState.DEAD, JobState.DONE)
    return record.outcome.stage if is_over and isinstance(record.outcome, Rejection) else ""


def _say(text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
