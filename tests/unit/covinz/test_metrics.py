"""What becomes of a status and of durations."""

from __future__ import annotations

from collections.abc import Mapping

from prometheus_client.parser import text_string_to_metric_families

from covinz.metrics import render
from covinz.telemetry import BUCKETS_S, Telemetry
from covinz.types import Status

Samples = dict[tuple[str, tuple[tuple[str, str], ...]], float]


def status(counters: Mapping[str, float]) -> Status:
    return Status("ingest", "ingest", "", 7, 2, 0, False, counters)


def samples(text: bytes) -> Samples:
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in text_string_to_metric_families(text.decode())
        for sample in family.samples
    }


def test_a_status_gets_names_types_and_labels() -> None:
    found = samples(
        render(
            "ingest",
            status({"keyframes": 5, "keyframes.a1": 3, "keyframes.b": 2, "rejected.malformed": 1}),
            {},
        )
    )
    assert found["covinz_ingest_keyframes_total", (("agent", "a1"),)] == 3
    assert found["covinz_ingest_keyframes_total", (("agent", "b"),)] == 2
    assert found["covinz_ingest_rejected_uploads_total", (("code", "malformed"),)] == 1
    assert found["covinz_service_cursor", (("service", "ingest"),)] == 7
    assert found["covinz_service_queue_length", (("service", "ingest"),)] == 2
    assert found["covinz_service_up", (("service", "ingest"),)] == 1
    assert ("covinz_ingest_keyframes", ()) not in found  # would count everything twice
    assert found["process_resident_memory_bytes", ()] > 1e6


def test_a_number_that_nobody_has_described_is_there_all_the_same() -> None:
    found = samples(render("ingest", status({"brand-new.x": 4.0}), {}))
    assert found["covinz_ingest_brand_new_x", ()] == 4


def test_a_process_that_does_not_answer_is_down_and_its_memory_is_told() -> None:
    found = samples(render("ingest", None, {}))
    assert found["covinz_service_up", (("service", "ingest"),)] == 0
    assert ("covinz_service_cursor", (("service", "ingest"),)) not in found
    assert ("process_cpu_seconds_total", ()) in found


def test_durations_become_a_histogram() -> None:
    telemetry = Telemetry()
    for seconds in (0.0, BUCKETS_S[0], 0.3, 1e6):
        telemetry.observe("ingest_ack", seconds)
    found = samples(render("ingest", None, telemetry.distributions()))
    name = "covinz_ingest_ack_seconds"
    assert found[f"{name}_bucket", (("le", str(BUCKETS_S[0])),)] == 2
    assert found[f"{name}_bucket", (("le", "0.25"),)] == 2
    assert found[f"{name}_bucket", (("le", "0.5"),)] == 3
    assert found[f"{name}_bucket", (("le", "60.0"),)] == 3
    assert found[f"{name}_bucket", (("le", "+Inf"),)] == 4 == found[f"{name}_count", ()]
    assert found[f"{name}_sum", ()] == BUCKETS_S[0] + 0.3 + 1e6
