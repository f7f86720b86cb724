"""``python -m services.optimizer``: maps and corrections as a process."""

from __future__ import annotations

from covinz.service import serve
from services.optimizer.service import run

if __name__ == "__main__":
    serve("optimizer", run)
