"""Names of metrics keep Prometheus' conventions, and the guide has them all."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from covinz import metrics
from covinz.supervisor import server_specs

GUIDE = (Path(__file__).parents[2] / "docs" / "deployment.md").read_text()
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
