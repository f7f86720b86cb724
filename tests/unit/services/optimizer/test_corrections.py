"""The mathematics of corrections and of their jumps."""

from __future__ import annotations

import numpy as np
import pytest

from covinz.config import OptimizerConfig
from covinz.frames import Array, so3_exp, transform
from covinz.types import Correction
from services.optimizer.corrections import body_motion, make_correction
from services.optimizer.maps import PublishedMap
from services.optimizer.optimisation import MapEstimate, Placement
from tests.fleets import keyframe

CONFIG = OptimizerConfig(jump_m=0.1, jump_rad=0.05)
T_ODOM_BODY = transform(so3_exp([0.0, 0.0, 1.0]), [100.0, 0.0, 0.0])


def correction(
    T_map_odom: Array, previous: Correction | None = None, segment: int = 0, oldest: int = 0
) -> Correction:
    kf = keyframe("a", segment, 9).id
    placement = Placement(kf, T_ODOM_BODY, T_map_odom)
    placements = {keyframe("a", oldest, 0).id.segment: placement, kf.segment: placement}
    estimate = MapEstimate(placements, (), np.arange(1), T_ODOM_BODY[None], 1, True)
    return make_correction(PublishedMap(estimate, 5), placement, previous, CONFIG, 77)


def yaw(radians: float) -> Array:
    return transform(so3_exp([0.0, 0.0, radians]), np.zeros(3))


def test_a_correction_names_what_it_is_made_of() -> None:
    made = correction(yaw(0.3), segment=4, oldest=2)
    assert made.keyframe == keyframe("a", 4, 9).id
    assert (made.map_id, made.map_revision) == (keyframe("a", 2, 0).id.session, 5)
    assert made.stamp_ns == 77
    np.testing.assert_array_equal(made.T_map_odom, yaw(0.3))


def test_the_first_correction_is_no_jump() -> None:
    assert not correction(yaw(3.0)).jumped


def test_time_stamps_grow_even_if_the_clock_is_set_back() -> None:
    first = correction(np.eye(4))
    assert correction(np.eye(4), first).stamp_ns == first.stamp_ns + 1


@pytest.mark.parametrize(
    ("T_map_odom", "jumped"),
    [
        (np.eye(4), False),
        (transform(np.eye(3), [0.09, 0.0, 0.0]), False),
        (transform(np.eye(3), [0.11, 0.0, 0.0]), True),
        # A hundred metres from the odom origin a milliradian is a decimetre.
        (yaw(0.0009), False),
        (yaw(0.0011), True),
        # About the body itself only the rotation counts.
        (T_ODOM_BODY @ yaw(0.04) @ np.linalg.inv(T_ODOM_BODY), False),
        (T_ODOM_BODY @ yaw(0.06) @ np.linalg.inv(T_ODOM_BODY), True),
    ],
)
def test_a_jump_is_what_moves_the_robot(T_map_odom: Array, jumped: bool) -> None:
    assert correction(T_map_odom, correction(np.eye(4))).jumped is jumped


def test_another_map_or_session_is_a_jump() -> None:
    first = correction(np.eye(4), segment=1, oldest=1)
    assert correction(np.eye(4), first, segment=1, oldest=0).jumped
    assert correction(np.eye(4), first, segment=2, oldest=1).jumped
    assert not correction(np.eye(4), first, segment=1, oldest=1).jumped


def test_body_motion_is_that_of_the_body() -> None:
    metres, radians = body_motion(np.eye(4), yaw(0.01), T_ODOM_BODY)
    assert metres == pytest.approx(2 * 100 * np.sin(0.005))
    assert radians == pytest.approx(0.01)
