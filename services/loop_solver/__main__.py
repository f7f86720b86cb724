"""``python -m services.loop_solver``: a worker that verifies loop candidates, as a process."""

from __future__ import annotations

from covinz.heap import keep_freed_memory
from covinz.service import serve
from services.loop_solver.service import run

if __name__ == "__main__":
    keep_freed_memory()  # a job takes and frees megabytes
    serve("loop_solver", run)
