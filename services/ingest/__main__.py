"""``python -m services.ingest``: the keyframe log as a process."""

from __future__ import annotations

from covinz.service import serve
from services.ingest.service import run

if __name__ == "__main__":
    serve("ingest", run)
