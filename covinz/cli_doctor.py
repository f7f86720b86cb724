"""``covinz doctor``: says why nothing arrives."""

from __future__ import annotations

import sys
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from covinz.connection import CredentialsFile, Endpoint, bus_config
from covinz.doctor import Verdict, examine, is_well
from covinz.doctor import calibration as look_at_calibration

console = Console()
COLOURS = {Verdict.GOOD: "green", Verdict.ODD: "yellow", Verdict.BAD: "red"}


def doctor(
    endpoint: Endpoint = None,
    credentials: CredentialsFile = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Look at this calib.yaml first.", exists=True)
    ] = None,
) -> None:
    """Say why nothing arrives: credentials, connection, clocks, processes, robots."""
    findings = []
    looked_at = () if calibration is None else look_at_calibration(calibration)
    for finding in chain(looked_at, examine(bus_config(endpoint, credentials))):
        findings.append(finding)
        console.print(f"[{COLOURS[finding.verdict]}]{finding.verdict:4}[/]", end="  ")
        for text in filter(None, (finding.text, finding.advice and f"      {finding.advice}")):
            console.print(text, markup=False, highlight=False, soft_wrap=True)
    if not is_well(findings):
        sys.exit(1)
