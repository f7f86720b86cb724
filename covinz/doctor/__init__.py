"""Why nothing arrives: looks at the way to a server step by step and says what it finds."""

from covinz.doctor.connection import calibration, examine, of_robot
from covinz.doctor.findings import Finding, Verdict, is_well
from covinz.doctor.server import SERVICES, of_server

__all__ = [
    "SERVICES",
    "Finding",
    "Verdict",
    "calibration",
    "examine",
    "is_well",
    "of_robot",
    "of_server",
]
