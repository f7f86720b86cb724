"""What a report was made with: version, revision, machine, and settings that differ."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

from covinz.config import Config

_CHECKOUT = Path(__file__).resolve().parents[1]


def provenance(settings: Config) -> dict[str, Any]:
    """JSON-ready facts; ``revision`` is None outside of a checkout with git."""
    return {
        "version": metadata.version("covinz"),
        "revision": revision(_CHECKOUT),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cpus": os.cpu_count(),
        "config": differences(settings),
    }


def revision(checkout: Path) -> str | None:
    """Commit of a checkout, with ``-dirty`` when tracked files differ from it; None if unknown."""
    if not (checkout / ".git").exists():
        return None
    command = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None


def differences(settings: Config) -> dict[str, Any]:
    """Settings that differ from the defaults, but for the address, which is drawn for each run."""
    found = _differences(settings.model_dump(mode="json"), Config().model_dump(mode="json"))
    bus = {name: value for name, value in found.pop("bus", {}).items() if name != "endpoint"}
    return {**({"bus": bus} if bus else {}), **found}


def _differences(values: dict[str, Any], defaults: dict[str, Any]) -> dict[str, Any]:
    found = {}
    for name, value in values.items():
        default = defaults.get(name)
        if isinstance(value, dict) and isinstance(default, dict):
            value, default = _differences(value, default), {}
        if value != default:
            found[name] = value
    return found
