"""Fixtures for all tests: recorded data, a free port, real processes."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from covinz.bus import ZenohBus
from covinz.config import BusConfig

CHECKOUT = Path(__file__).resolve().parent.parent
STOP_S = 15.0

StartProcess = Callable[..., subprocess.Popen[str]]


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> None:
    """What tests start can be interrupted, even if a shell runs them in the background."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def recorded_data() -> Path:
    """Folder of recorded images and trajectories; the test is skipped where there is none."""
    default = CHECKOUT.parent / "shared" / "data"
    folder = Path(os.environ.get("COVINZ_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no recorded data at {folder}; COVINZ_DATA may name another folder")
    return folder


@pytest.fixture(scope="session", autouse=True)
def image_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Rendered images are made once in a run of the tests, and nothing is left in the home."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COVINZ_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def free_endpoint() -> str:
    """A loopback endpoint that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def bus_config(free_endpoint: str) -> BusConfig:
    """The bus of one test."""
    return BusConfig(endpoint=free_endpoint)


@pytest.fixture
def config_file(tmp_path: Path, bus_config: BusConfig) -> Path:
    """A configuration file with nothing but the endpoint of this test."""
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump({"bus": bus_config.model_dump(mode="json")}))
    return path


@pytest.fixture
def start_program(tmp_path: Path) -> Iterator[StartProcess]:
    """Start a program from the checkout: ``start_program(name, command)``.

    Its standard error is appended to ``tmp_path/<name>.log``. At the end of the test what still
    runs is told to stop, and killed if it does not.
    """
    with ExitStack() as stack:

        def start(name: str, command: Sequence[str]) -> subprocess.Popen[str]:
            with (tmp_path / f"{name}.log").open("a") as log:
                process = subprocess.Popen(command, cwd=CHECKOUT, stderr=log, text=True)
            stack.callback(end, process)
            return process

        yield start


@pytest.fixture
def start_service(tmp_path: Path, config_file: Path, start_program: StartProcess) -> StartProcess:
    """Start ``python -m services.<name>``: ``start_service(name, instance=name)``.

    Its files are in ``tmp_path/data``, its log is ``tmp_path/<instance>.log``.
    """

    def start(name: str, instance: str | None = None) -> subprocess.Popen[str]:
        instance = instance or name
        command = [sys.executable, "-m", f"services.{name}", "--config", str(config_file)]
        command += ["--data", str(tmp_path / "data"), "--id", instance]
        return start_program(instance, command)

    return start


def end(process: subprocess.Popen[str]) -> None:
    """Stop a process that this test started."""
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
    process.wait()


@pytest.fixture
def open_bus(bus_config: BusConfig) -> Iterator[Callable[[], ZenohBus]]:
    """Open sessions on the bus of this test; closed at its end."""
    with ExitStack() as stack:

        def open_() -> ZenohBus:
            bus = ZenohBus.open(bus_config, wait_s=0.0)
            stack.callback(bus.close)
            return bus

        yield open_
