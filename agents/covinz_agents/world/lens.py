"""Which ray each raw pixel sees, and perspective views from which a lens's image is taken.

A rasteriser draws straight lines only, so a distorted image is resampled from one or several
perspective views: one for ordinary lenses, sides of a cube for wide ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from covinz.types import Array, Camera

# A single view is used up to this tangent of the angle from its axis: beyond it most of its
# pixels would be spent on the rim.
_WIDEST_SINGLE_VIEW = 1.8
# Rows and columns drawn around what is needed, for interpolation at the rim.
_MARGIN_PX = 2
_ITERATIONS = 30
_CONVERGED = 1e-10
# Looking forward, right, left, down, up and back: rows are the view's axes in the camera.
_CUBE = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],
    ],
    dtype=float,
)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A perspective image, and which raw pixels are taken from where in it.

    Attributes:
        R_view_cam: (3, 3) rotation into the view's axes (x right, y down, z forward).
        focal_px: Focal length of both axes.
        center_px: (2,) principal point; (0, 0) is the centre of the top-left pixel.
        size_px: Width and height.
        pixels: (N,) indices of raw pixels, row by row.
        x_px: (N,) where they are in the view, float32.
        y_px: (N,)
    """

    R_view_cam: Array
    focal_px: float
    center_px: Array
    size_px: tuple[int, int]
    pixels: NDArray[np.intp]
    x_px: NDArray[np.float32]
    y_px: NDArray[np.float32]


def pixel_rays(camera: Camera) -> Array:
    """(H, W, 3) unit directions, in the camera, that its raw pixels see.

    NaN where the model maps no direction to a pixel.

    Source: the camera models of COLMAP and OpenCV, whose parameters and order they share.
    """
    fx, fy, cx, cy = camera.params[:4]
    x, y = np.meshgrid((np.arange(camera.width) - cx) / fx, (np.arange(camera.height) - cy) / fy)
    if camera.model == "OPENCV_FISHEYE":
        return _fisheye_rays(x, y, camera.params[4:])
    coefficients = np.zeros(8)
    coefficients[: len(camera.params) - 4] = camera.params[4:]
    x, y = _undistorted(x, y, coefficients)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    unit: Array = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return unit


def views(camera: Camera, oversampling: float) -> list[View]:
    """Views whose pixels are finer than the camera's by a factor, in the middle of the image."""
    rays = pixel_rays(camera).reshape(-1, 3)
    focal_px = oversampling * float(np.sqrt(camera.params[0] * camera.params[1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.nanmax(np.abs(rays[:, :2] / rays[:, 2:]))
    if np.nanmin(rays[:, 2]) > 0 and slope <= _WIDEST_SINGLE_VIEW:
        return [_view(np.eye(3), rays, ~np.isnan(rays[:, 0]), focal_px)]
    forward = np.einsum("sj,nj->ns", _CUBE[:, 2], np.nan_to_num(rays))
    nearest = np.where(np.isnan(rays[:, 0]), -1, forward.argmax(axis=1))
    return [
        _view(axes, rays, nearest == side, focal_px)
        for side, axes in enumerate(_CUBE)
        if np.any(nearest == side)
    ]


def _view(R_view_cam: Array, rays: Array, seen: NDArray[np.bool_], focal_px: float) -> View:
    directions = rays[seen] @ R_view_cam.T
    at = focal_px * directions[:, :2] / directions[:, 2:]
    low = np.floor(at.min(axis=0)) - _MARGIN_PX
    width, height = (np.ceil(at.max(axis=0)) + _MARGIN_PX - low + 1).astype(int)
    x, y = (at - low).astype(np.float32).T
    return View(
        R_view_cam,
        focal_px,
        -low,
        (int(width), int(height)),
        np.flatnonzero(seen),
        np.ascontiguousarray(x),
        np.ascontiguousarray(y),
    )


def _undistorted(x_d: Array, y_d: Array, coefficients: Array) -> tuple[Array, Array]:
    """Newton's method on the rational radial and tangential model; NaN where it has no answer."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = x_d.copy(), y_d.copy()
    with np.errstate(all="ignore"):
        for _ in range(_ITERATIONS):
            r2 = x * x + y * y
            above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
            radial = above / below
            # Derivative by r^2.
            slope = (k1 + r2 * (2 * k2 + r2 * 3 * k3)) / below
            slope -= radial * (k4 + r2 * (2 * k5 + r2 * 3 * k6)) / below
            error_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - x_d
            error_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - y_d
            xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
            xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
            yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
            det = xx * yy - xy * xy
            x -= (yy * error_x - xy * error_y) / det
            y -= (xx * error_y - xy * error_x) / det
            error = np.maximum(np.abs(error_x), np.abs(error_y))
            if np.all(error < _CONVERGED):
                break
        seen = (error < _CONVERGED) & (det > 0) & (radial > 0)
    return np.where(seen, x, np.nan), np.where(seen, y, np.nan)


def _fisheye_rays(x_d: Array, y_d: Array, coefficients: Array) -> Array:
    """Newton's method on theta_d = theta (1 + k1 theta^2 + ...), by the angle from the axis."""
    k1, k2, k3, k4 = coefficients
    theta_d = np.hypot(x_d, y_d)
    theta = theta_d.copy()
    with np.errstate(all="ignore"):
        for _ in range(_ITERATIONS):
            t2 = theta * theta
            error = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) - theta_d
            slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
            theta -= error / slope
            if np.all(np.abs(error) < _CONVERGED):
                break
        seen = (np.abs(error) < _CONVERGED) & (slope > 0) & (theta < np.pi)
        scale = np.where(theta_d > 0, np.sin(theta) / theta_d, 1.0)
    rays = np.stack([x_d * scale, y_d * scale, np.cos(theta)], axis=-1)
    return np.where(seen[..., None], rays, np.nan)


def resample(image: NDArray[np.float32], view: View) -> NDArray[np.float32]:
    """(N, C) colours of the raw pixels of a view, between four pixels of its image."""
    # OpenCV's map is an image itself, of at most 32767 rows: one of that many columns.
    columns = 1024
    rows = -(-len(view.x_px) // columns)
    map_x, map_y = (np.resize(axis, (rows, columns)) for axis in (view.x_px, view.y_px))
    taken = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours = taken.reshape(rows * columns, -1)[: len(view.x_px)]
    return np.asarray(colours, dtype=np.float32)
