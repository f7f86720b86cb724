"""``python -m services.loop_solver``: a worker that verifies loop candidates, as a process."""

from __future__ import annotations

from covinz.service import serve
from services.loop_solver.service import run

if __name__ == "__main__":
    serve("loop_solver", run)
