"""``python -m services.loop_solver``: a worker that verifies loop candidates, as a process."""

from __future__ import annotations

import os


def main() -> None:
    """Serve with one thread for numbers: more cores are used by starting more workers."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ[name] = "1"
    # Only now: these libraries read the environment when they are loaded.
    from covinz.service import serve
    from services.loop_solver.service import run

    serve("loop_solver", run)


if __name__ == "__main__":
    main()
