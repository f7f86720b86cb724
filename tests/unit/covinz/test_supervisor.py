"""The supervisor with real child processes."""

from __future__ import annotations

import json
import os
import pty
import shutil
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from covinz.supervisor import (
    ProcessSpec,
    Supervisor,
    child_environment,
    processors_of,
    server_specs,
)

# Says that it is up by making a file named after its pid, then waits for a signal.
CHILD = (
    "import os, signal, sys\n"
    "{before}\n"
    "open(os.path.join({folder!r}, str(os.getpid())), 'w').close()\n"
    "signal.pause()\n"
)


def spec(name: str, folder: Path, before: str = "") -> ProcessSpec:
    return ProcessSpec(
        name, (sys.executable, "-c", CHILD.format(folder=str(folder), before=before))
    )


def wait_for(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    tick = threading.Event()
    for _ in range(int(timeout_s / 0.02)):
        if condition():
            return
        tick.wait(0.02)
    pytest.fail("the condition never became true")


def started(folder: Path) -> list[int]:
    return sorted(int(file.name) for file in folder.iterdir())


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_killed_process_is_started_again_and_all_end_at_stop(tmp_path: Path) -> None:
    up = tmp_path / "up"
    up.mkdir()
    pid_file = tmp_path / "processes.json"
    with Supervisor([spec("a", up)], logs=tmp_path / "logs", pid_file=pid_file) as supervisor:
        wait_for(lambda: len(started(up)) == 1)
        first = started(up)[0]
        assert json.loads(pid_file.read_text()) == {"a": {"pid": first, "starts": 1}}
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: len(started(up)) == 2)
        wait_for(lambda: json.loads(pid_file.read_text())["a"]["starts"] == 2)
        assert supervisor.starts() == {"a": 2}
        second = next(pid for pid in started(up) if pid != first)
        assert json.loads(pid_file.read_text())["a"]["pid"] == second
    assert not alive(second)


def test_a_process_that_ignores_sigterm_is_killed(
    tmp_path: Path,
) -> None:
    up = tmp_path / "up"
    up.mkdir()
    deaf = "signal.signal(signal.SIGTERM, signal.SIG_IGN)"
    supervisor = Supervisor([spec("deaf", up, deaf)], grace_s=0.2)
    supervisor.start()
    wait_for(lambda: len(started(up)) == 1)
    supervisor.stop()
    assert not alive(started(up)[0])


BEATS = (
    "import threading\n"
    "from covinz.beats import Beats\n"
    "def beat():\n"
    "    while True:\n"
    "        Beats.of_process().send()\n"
    "        threading.Event().wait(0.1)\n"
    "threading.Thread(target=beat, daemon=True).start()"
)


def test_a_process_that_hangs_is_killed_and_started_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    up = tmp_path / "up"
    up.mkdir()
    beating = ProcessSpec("a", spec("a", up, BEATS).argv, beats=True)
    silent = spec("b", up)  # does not promise any heartbeat
    with Supervisor([beating, silent], silent_s=3.0) as supervisor:
        wait_for(lambda: len(started(up)) == 2)
        victim = next(
            pid for pid in started(up) if b"Beats" in Path(f"/proc/{pid}/cmdline").read_bytes()
        )
        os.kill(victim, signal.SIGSTOP)
        wait_for(lambda: supervisor.starts() == {"a": 2, "b": 1})
        wait_for(lambda: len(started(up)) == 3)
    assert "a gives no sign of life any more" in caplog.text
    assert "b gives no sign" not in caplog.text


def test_output_goes_to_a_log_of_its_own(tmp_path: Path) -> None:
    up = tmp_path / "up"
    up.mkdir()
    logs = tmp_path / "logs"
    with Supervisor([spec("talker", up, "print('hello', flush=True)")], logs=logs):
        wait_for(lambda: len(started(up)) == 1)
    assert (logs / "talker.log").read_text() == "hello\n"


def test_children_die_with_a_killed_supervisor(tmp_path: Path) -> None:
    up = tmp_path / "up"
    up.mkdir()
    script = (
        "import signal\n"
        "from covinz.supervisor import ProcessSpec, Supervisor\n"
        f"Supervisor([ProcessSpec('a', {spec('a', up).argv!r})]).start()\n"
        "signal.pause()\n"
    )
    parent = os.posix_spawn(sys.executable, [sys.executable, "-c", script], os.environ)
    wait_for(lambda: len(started(up)) == 1)
    child = started(up)[0]
    os.kill(parent, signal.SIGKILL)
    os.waitpid(parent, 0)
    wait_for(lambda: not alive(child))


def test_children_are_of_our_session_but_not_of_our_group(tmp_path: Path) -> None:
    # Ctrl-C must not reach them, and who gives way to whom only counts within a session.
    up = tmp_path / "up"
    up.mkdir()
    with Supervisor([spec("a", up), spec("b", up)]):
        wait_for(lambda: len(started(up)) == 2)
        children = started(up)
        assert {os.getsid(pid) for pid in children} == {os.getsid(0)}
        assert {os.getpgid(pid) for pid in children} == set(children)


def test_a_terminal_that_stops_background_writers_does_not_stop_children(tmp_path: Path) -> None:
    up = tmp_path / "up"
    up.mkdir()
    script = (
        "import signal, termios\n"
        "from covinz.supervisor import ProcessSpec, Supervisor\n"
        "modes = termios.tcgetattr(0)\n"
        "modes[3] |= termios.TOSTOP\n"
        "termios.tcsetattr(0, termios.TCSANOW, modes)\n"
        f"argv = {spec('a', up, before='print(1, flush=True)').argv!r}\n"
        "Supervisor([ProcessSpec('a', argv)]).start()\n"
        "signal.pause()\n"
    )
    parent, terminal = pty.fork()
    if parent == 0:
        os.execv(sys.executable, [sys.executable, "-c", script])
    try:
        wait_for(lambda: len(started(up)) == 1)  # it goes on after it has written
    finally:
        os.kill(parent, signal.SIGKILL)
        os.waitpid(parent, 0)
        os.close(terminal)


def test_settings_of_the_environment_are_not_inherited() -> None:
    environment = child_environment(
        {"COVINZ__BUS__ENDPOINT": "tcp/elsewhere:1", "COVINZ_DATA": "/data"}
    )
    assert "COVINZ__BUS__ENDPOINT" not in environment
    assert environment["COVINZ_DATA"] == "/data"


def test_the_server_has_each_service_once_and_the_workers_asked_for(tmp_path: Path) -> None:
    specs = server_specs(tmp_path / "config.yaml", tmp_path, workers=3)
    assert [spec.name for spec in specs] == [
        *("router", "ingest", "place_recognition", "optimizer"),
        *("loop_solver-0", "loop_solver-1", "loop_solver-2"),
    ]
    assert all("--data" in spec.argv and "--config" in spec.argv for spec in specs)


@pytest.mark.parametrize(
    ("workers", "processors"),
    [(1, [None]), (2, [None, None]), (3, [1, 4, 5]), (4, [None, None, None, None])],
)
def test_loop_solvers_that_fill_the_machine_get_a_processor_each(
    workers: int, processors: list[int | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {4, 1, 5}, raising=False)
    assert processors_of(workers) == processors
    specs = server_specs(Path("config.yaml"), Path("data"), workers)
    assert [spec.processor for spec in specs] == [None, None, None, None, *processors]


def test_one_loop_solver_on_one_processor_is_not_bound_to_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    assert processors_of(1) == [None]


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="processes cannot be bound here")
def test_a_process_stays_on_its_processor_also_when_it_is_started_again(tmp_path: Path) -> None:
    up = tmp_path / "up"
    up.mkdir()
    last = max(os.sched_getaffinity(0))
    bound = ProcessSpec("bound", spec("bound", up).argv, processor=last)
    with Supervisor([bound]):
        wait_for(lambda: len(started(up)) == 1)
        first = started(up)[0]
        assert os.sched_getaffinity(first) == {last}
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: len(started(up)) == 2)
        second = next(pid for pid in started(up) if pid != first)
        assert os.sched_getaffinity(second) == {last}


def test_a_processor_that_is_gone_keeps_no_process_from_starting(tmp_path: Path) -> None:
    up = tmp_path / "up"
    up.mkdir()
    with Supervisor([ProcessSpec("a", spec("a", up).argv, processor=1_000_000)]):
        wait_for(lambda: len(started(up)) == 1)


def test_a_process_is_started_again_although_its_files_cannot_be_written(tmp_path: Path) -> None:
    up, files = tmp_path / "up", tmp_path / "files"
    up.mkdir()
    files.mkdir()
    pid_file = files / "processes.json"
    with Supervisor([spec("a", up)], logs=files / "logs", pid_file=pid_file) as supervisor:
        wait_for(lambda: len(started(up)) == 1)
        first = started(up)[0]
        # What a full disk does: neither the log nor the file of pids can be written.
        shutil.rmtree(files)
        files.touch()
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: supervisor.starts() == {"a": 2})
        wait_for(lambda: len(started(up)) == 2)
        second = next(pid for pid in started(up) if pid != first)
    assert not alive(second)


def test_a_process_that_cannot_be_started_is_tried_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    up = tmp_path / "up"
    up.mkdir()
    program = tmp_path / "program"
    made = ProcessSpec("a", (str(program), *spec("a", up).argv[1:]))
    with Supervisor([made]):
        wait_for(lambda: "cannot start a" in caplog.text)
        program.symlink_to(sys.executable)
        wait_for(lambda: len(started(up)) == 1)
