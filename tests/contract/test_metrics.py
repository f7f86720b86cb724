"""Names of metrics keep Prometheus' conventions, and the guide has them all."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from covinz import metrics
from covinz.supervisor import server_specs

DOCS = Path(__file__).parents[2] / "docs"
GUIDE = (DOCS / "deployment.md").read_text()
NAMES = re.findall(r"^\| `(\w+)", metrics.table(), re.MULTILINE)


def test_the_guide_has_the_table() -> None:
    assert metrics.table() in GUIDE, "python -m covinz.metrics prints it"


def test_every_service_is_described() -> None:
    specs = server_specs(Path("config.yaml"), Path("data"), workers=1)
    modules = {spec.argv[spec.argv.index("-m") + 1] for spec in specs}
    assert {module.removeprefix("services.") for module in modules} == metrics.METRICS.keys()


@pytest.mark.parametrize("name", NAMES)
def test_names_are_as_prometheus_wants_them(name: str) -> None:
    assert re.fullmatch(r"covinz_[a-z_]+", name)
    assert NAMES.count(name) == 1
    assert not name.endswith(("_count", "_sum", "_bucket", "_info"))


def test_the_dashboard_asks_for_metrics_and_labels_that_are_there() -> None:
    dashboard: dict[str, Any] = json.loads((DOCS / "grafana" / "covinz.json").read_text())
    labels = {"service", "instance", "le", "job"}
    labels |= {one.label for described in metrics.METRICS.values() for one in described}
    targets = [target for panel in dashboard["panels"] for target in panel["targets"]]
    assert len(targets) > 12
    for target in targets:
        asked = set(re.findall(r"covinz_[a-z_]+", target["expr"]))
        known = {re.sub(r"_bucket$", "", name) for name in asked}
        assert known <= set(NAMES) and (known or "process_" in target["expr"]), target
        shown = re.findall(r"\{\{(\w+)\}\}|by \((\w+)\)", str(target))
        assert {name for pair in shown for name in pair if name} <= labels, target
