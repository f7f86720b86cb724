"""covinz.backup knows the kinds of file that the services write."""

from __future__ import annotations

from covinz.backup import KINDS
from services.ingest.keyframe_log import LOG_FILE
from services.optimizer import loop_store
from services.place_recognition import journal


def test_kinds_and_versions_are_those_of_the_services() -> None:
    kinds = {
        "place_recognition": journal.KIND,
        "optimizer": loop_store.KIND,
        "ingest": LOG_FILE,
    }
    assert {name: (kind.application_id, kind.version) for name, kind in kinds.items()} == KINDS


def test_consumers_are_copied_before_the_log() -> None:
    assert list(KINDS)[-1] == "ingest"
