"""Claim: no bytes that a stranger sends do anything but be refused.

Messages of every type, spoilt in every way of `tests/fuzz/mutations.py`, are read by the functions
that the services call. Only MalformedMessage may come out, or a value that can be sent on; in
bounded time, with memory in proportion to the message, and none of it kept. A crash or a hang ends
the process; its seed does it again.

Runs with other seeds add up with --add: `totals` is over all of `runs`.

    python -m benchmarks.fuzz_decoding [--decodes N] [--seed S] [--json FILE [--add]] [--corpus DIR]
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import sys
import time
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.fuzz.fuzzing import MAX_CPU_S, MAX_PEAK_BYTES, MAX_PEAK_PER_BYTE, Fuzzer
from tests.fuzz.inputs import good_messages, read_corpus, write_corpus

# Nothing was decoded for so long: the process ends and says where it was. [s of wall clock]
HANG_S = 300.0
_MIB = 1 << 20


def run(decodes: int, seed: int, corpus: Path | None) -> tuple[Fuzzer, dict[str, Any]]:
    """Decode so many messages; the fuzzer as it ended, and what the run came to."""
    fuzzer = Fuzzer(good_messages(), seed)
    for name, payloads in (read_corpus(corpus) if corpus else {}).items():
        for payload in payloads:
            fuzzer.learn(name, payload)
    began_s = time.process_time()
    _fuzz(fuzzer, decodes // 10)
    early_mib = resident_mib()
    _fuzz(fuzzer, decodes - decodes // 10)
    faulthandler.cancel_dump_traceback_later()
    tally = fuzzer.tally
    return fuzzer, {
        "seed": seed,
        "decodes": tally.decodes,
        "accepted": tally.accepted,
        "refused": tally.decodes - tally.accepted - len(tally.findings),
        "findings": len(tally.findings),
        "paths": len(fuzzer.corpus),
        "cpu_s": round(time.process_time() - began_s, 1),
        "slowest_ms": round(1e3 * tally.slowest_s, 2),
        "peak_bytes": tally.most_peak_bytes,
        "peak_per_byte": round(tally.most_peak_per_byte, 1),
        "rss_growth_mib": round(resident_mib() - early_mib, 2),
        "by_message": dict(sorted(tally.by_message.items())),
        "by_mutation": dict(sorted(tally.by_mutation.items())),
    }


def _fuzz(fuzzer: Fuzzer, decodes: int) -> None:
    while decodes:
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        chunk = min(decodes, 10_000)
        fuzzer.run(chunk)
        decodes -= chunk


def resident_mib() -> float:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / _MIB


def report(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All runs, and what they came to together."""
    by_message: Counter[str] = Counter()
    for made in runs:
        by_message.update(made["by_message"])
    added = ("decodes", "accepted", "refused", "findings")
    worst = ("slowest_ms", "peak_bytes", "peak_per_byte", "rss_growth_mib", "paths")
    totals: dict[str, Any] = {name: sum(made[name] for made in runs) for name in added}
    totals |= {name: max(made[name] for made in runs) for name in worst}
    # A run that crashed or hung leaves no figures: these are those that ended.
    totals |= {"message_types": len(by_message), "by_message": dict(sorted(by_message.items()))}
    limits = {
        "cpu_s": MAX_CPU_S,
        "peak_bytes": MAX_PEAK_BYTES,
        "peak_per_byte": MAX_PEAK_PER_BYTE,
    }
    return {
        "benchmark": "fuzz_decoding",
        "limits_of_one_decode": limits,
        "totals": totals,
        "runs": list(runs),
    }


def main() -> int:
    """Fuzz, print and write JSON; 1 when something was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--decodes", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="file for the JSON, besides standard output")
    parser.add_argument("--add", action="store_true", help="to the runs that are in the file")
    parser.add_argument("--corpus", type=Path, help="begin with this corpus and add to it")
    arguments = parser.parse_args()
    warnings.simplefilter("error")  # a warning is not a refusal
    fuzzer, made = run(arguments.decodes, arguments.seed, arguments.corpus)
    for number, finding in enumerate(fuzzer.tally.findings[:20]):
        file = Path(f"finding-{arguments.seed}-{number}.bin")
        file.write_bytes(finding.payload)
        sys.stderr.write(f"{file}: {finding.message}: {finding.what}\n")
    runs = [made]
    if arguments.json and arguments.add and arguments.json.exists():
        runs = [*json.loads(arguments.json.read_text())["runs"], made]
    text = json.dumps(report(runs), indent=2) + "\n"
    sys.stdout.write(text)
    if arguments.json:
        arguments.json.write_text(text)
    if arguments.corpus:
        kept: dict[str, list[bytes]] = {}
        for name, payload in fuzzer.corpus.values():
            kept.setdefault(name, []).append(payload)
        write_corpus(arguments.corpus, kept)
    return int(bool(fuzzer.tally.findings))


if __name__ == "__main__":
    sys.exit(main())
