"""Is a calibration one that a camera on a robot can have? For people; nothing is refused for it.

Limits are wide: whoever is outside has most likely mixed units, image sizes, the order of
parameters or the direction of a transform.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from covinz.types import Array, Camera

# The focal length in widths of the image: from a fisheye's 200 degrees to a lens of 8 degrees.
MIN_FOCAL, MAX_FOCAL = 0.15, 7.0
# The two focal lengths of square pixels are alike.
MAX_ASPECT = 1.15
# The principal point is so near to the middle. [widths or heights of the image]
MAX_OFF_CENTRE = 0.2
# The camera is on the robot. [m]
MAX_LEVER_M = 20.0
# Steps from the middle of the image to its furthest corner.
_STEPS = 200


@dataclass(frozen=True, slots=True)
class Complaint:
    """What is odd.

    Attributes:
        code: For counters.
        seen: What was seen, in words.
    """

    code: str
    seen: str

    @property
    def advice(self) -> str:
        """What to look at."""
        return ADVICE[self.code]


ADVICE: Mapping[str, str] = {
    "focal_length": "give it in pixels of the images that are sent, not in millimetres",
    "aspect": "COLMAP's order of parameters begins with fx, fy, cx, cy",
    "principal_point": "calibrate at the size of the images that are sent; the order is fx, fy, "
    "cx, cy",
    "distortion": "check the order of the parameters, and that the calibration covered the corners",
    "rotation": "the upper left 3 x 3 of T_body_cam is orthonormal with determinant 1",
    "lever": "T_body_cam is in metres: p_body = T_body_cam p_cam",
}


def complaints(camera: Camera) -> Iterator[Complaint]:
    """What is odd about a calibration; nothing for a good one."""
    fx, fy, cx, cy = camera.params[:4]
    width, height = camera.width, camera.height
    if not MIN_FOCAL * width <= fx <= MAX_FOCAL * width:
        yield Complaint(
            "focal_length",
            f"a focal length of {fx:g} px for an image {width} px wide",
        )
    elif not 1 / MAX_ASPECT <= fx / fy <= MAX_ASPECT:
        yield Complaint(
            "aspect",
            f"focal lengths of {fx:g} and {fy:g} px",
        )
    off = abs(cx / width - 0.5), abs(cy / height - 0.5)
    if max(off) > MAX_OFF_CENTRE:
        yield Complaint(
            "principal_point",
            f"a principal point at {cx:g}, {cy:g} in an image of {width} x {height} px",
        )
    edge = _folds_at(camera)
    if edge is not None:
        yield Complaint(
            "distortion",
            f"a distortion that folds the image over at {edge:.0%} of the way to its corner",
        )
    yield from _mounting(camera.T_body_cam)


def _mounting(T_body_cam: Array) -> Iterator[Complaint]:
    R, lever_m = T_body_cam[:3, :3], float(np.linalg.norm(T_body_cam[:3, 3]))
    if not np.allclose(R.T @ R, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
        yield Complaint(
            "rotation",
            "a T_body_cam whose rotation is none",
        )
    if lever_m > MAX_LEVER_M:
        yield Complaint(
            "lever",
            f"a camera {lever_m:g} m from the body",
        )


def _folds_at(camera: Camera) -> float | None:
    """The part of the way to the furthest corner at which distortion turns back, if it does.

    Along a ray from the optical axis the distorted radius grows with the true one as far as the
    model is good for anything.
    """
    fx, fy, cx, cy = camera.params[:4]
    corner = np.hypot(
        max(cx, camera.width - cx) / fx if fx else 0.0,
        max(cy, camera.height - cy) / fy if fy else 0.0,
    )
    coefficients = camera.params[4:]
    if not len(coefficients) or not np.isfinite(corner) or corner == 0.0:
        return None
    fisheye = camera.model == "OPENCV_FISHEYE"
    # True radius (fisheye: angle) up to where an undistorted lens would see three corners.
    r = np.linspace(0.0, np.pi if fisheye else 3.0 * corner, 3 * _STEPS)
    distorted = _distorted(camera.model, coefficients, r)
    reached = np.maximum.accumulate(distorted)
    falls = np.flatnonzero((np.diff(distorted) < 0) & (reached[:-1] < corner))
    return float(reached[falls[0]] / corner) if len(falls) else None


def _distorted(model: str, coefficients: Array, r: Array) -> Array:
    """Distorted radius of the true radius, or angle, without the tangential part."""
    if model == "OPENCV_FISHEYE":
        powers = np.stack([r ** (2 * k) for k in range(1, 5)])
        return np.asarray(r * (1 + coefficients[:4] @ powers))
    k1, k2 = coefficients[:2]
    above, below = 1 + k1 * r**2 + k2 * r**4, np.ones_like(r)
    if model == "FULL_OPENCV":
        k3, k4, k5, k6 = coefficients[4:8]
        above = above + k3 * r**6
        below = 1 + k4 * r**2 + k5 * r**4 + k6 * r**6
    return np.asarray(r * above / below)
