"""``python -m services.place_recognition``: loop candidates and the job desk as a process."""

from __future__ import annotations

from covinz.service import serve
from services.place_recognition.service import run

if __name__ == "__main__":
    serve("place_recognition", run)
