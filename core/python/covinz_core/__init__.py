"""Numeric core of covinz: loop geometry, place recognition, pose graph optimisation."""

from covinz_core._core import *  # noqa: F403
