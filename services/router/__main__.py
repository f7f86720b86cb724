"""``python -m services.router``: the Zenoh router as a process; `zenohd` works in its place."""

from __future__ import annotations

from covinz.service import serve
from services.router.service import run

if __name__ == "__main__":
    serve("router", run)
