"""Writes the golden messages that are missing; never touches one that is there.

python -m tests.contract.write_golden
"""

from __future__ import annotations

from pathlib import Path

from covinz import codec
from tests.contract.examples import EXAMPLES

GOLDEN = Path(__file__).parent / "golden"

if __name__ == "__main__":
    for name, message in EXAMPLES.items():
        path = GOLDEN / f"{name}.bin"
        if not path.exists():
            path.write_bytes(codec.encode(message))
