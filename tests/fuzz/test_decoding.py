"""All inputs of the corpus are refused or accepted, and the fuzzer finds defects."""

from __future__ import annotations

import dataclasses
import re
import struct
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from covinz import codec, keyexprs
from covinz.codec.layout import IDENTIFIERS
from covinz.types import AGENT_PATTERN, Status
from tests.fuzz.fuzzing import Fuzzer
from tests.fuzz.inputs import CORPUS, good_messages, read_corpus, write_corpus
from tests.fuzz.readers import READERS, Reader, send_on

GOOD = list(good_messages())
INPUTS = read_corpus()


@pytest.mark.parametrize("name", sorted(IDENTIFIERS))
def test_corpus(name: str) -> None:
    assert name in INPUTS, "a new message: `make fuzz` gives it inputs"
    num_refused = 0
    for payload in INPUTS[name]:
        for reader in READERS[name]:
            try:
                value = reader(payload)
            except codec.MalformedMessage:
                num_refused += 1
            else:
                send_on(value)
    assert num_refused >= 5


def test_corpus_is_small() -> None:
    assert sum(file.stat().st_size for file in CORPUS.iterdir()) < 2**20


def test_same_seed_is_the_same_run() -> None:
    fuzzers = [Fuzzer(GOOD, seed=7) for _ in range(2)]
    for fuzzer in fuzzers:
        fuzzer.run(2000)
    assert fuzzers[0].corpus == fuzzers[1].corpus
    assert not fuzzers[0].tally.findings


def careless(payload: bytes) -> Any:
    """Trusts lengths, as the runtime of FlatBuffers does."""
    message = codec.decode(payload, Status)
    struct.unpack_from("<I", payload, struct.unpack_from("<I", payload, 12)[0])
    return message


def greedy(payload: bytes) -> Any:
    """Makes room for as much as the message claims."""
    claimed = int.from_bytes(payload[-8:-4], "little") if len(payload) >= 8 else 0
    bytearray(min(claimed, 2**24))
    return codec.decode(payload, Status)


def unchecked(payload: bytes) -> Any:
    """Accepts what it could not send on."""
    return dataclasses.replace(codec.decode(payload, Status), cursor=-1)


@pytest.mark.parametrize(
    ("reader", "what"),
    [(careless, "struct.error|error\\("), (greedy, "allocated"), (unchecked, "accepted, but")],
)
def test_defects_are_found(reader: Reader, what: str) -> None:
    seeds = [(name, payload) for name, payload in GOOD if name == "Status"]
    fuzzer = Fuzzer(seeds, 0, {"Status": (reader,)})
    fuzzer.run(20_000, stop=lambda: bool(fuzzer.tally.findings))
    assert any(re.search(what, finding.what) for finding in fuzzer.tally.findings)


def test_corpus_is_the_same_file_for_the_same_inputs(tmp_path: Any) -> None:
    for folder in ("a", "b"):
        write_corpus(tmp_path / folder, {"Gap": [b"x", b"y" * 100]})
    one, two = (tmp_path / folder / "Gap.zip" for folder in ("a", "b"))
    assert one.read_bytes() == two.read_bytes()
    assert sorted(read_corpus(tmp_path / "a")["Gap"]) == [b"x", b"y" * 100]


@given(
    st.sampled_from(
        [
            keyexprs.agent_of,
            keyexprs.keyframe_of,
            keyexprs.camera_of,
            keyexprs.worker_of,
            keyexprs.map_of,
            keyexprs.service_of,
        ]
    ),
    st.sampled_from(["covinz/agent/", "covinz/keyframe/", "covinz/camera/", "covinz/", ""]),
    st.text(st.characters(), max_size=60),
)
def test_keys(parse: Callable[[str], Any], beginning: str, text: str) -> None:
    try:
        name = parse(beginning + text)
    except ValueError:
        return
    if parse is keyexprs.agent_of:
        assert AGENT_PATTERN.fullmatch(name)
