"""A simulated hall: landmarks on walls and objects, and what a camera sees of them.

It stands in for images where none are at hand. What makes visual SLAM hard is modelled: features
are seen from a range of distances and angles only, hide behind objects, are detected in one image
and missed in the next, and their descriptors change with the view. A descriptor bit is the sign
of an intensity difference, as in ORB: a random number of the landmark's, shifted by the view and
by noise, so that bits near zero flip first and a change of view flips the same bits each time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covinz.scenario import World
from covinz.types import Array

NUM_BITS = 256

# A landmark is detected from this share of its own distance to the inverse of it: ORB's pyramid
# of 8 levels by 1.2 spans a factor of 3.6 in all.
_MIN_DISTANCE_RATIO = 0.53
# Nearest and farthest own distance of a landmark. [m]
_OWN_DISTANCE_M = (1.2, 9.0)
# Surfaces are not recognised when seen more obliquely than 75 degrees.
_MIN_COS_INCIDENCE = 0.26
# Flat texture is seen from one side only.
_MIN_DEPTH_M = 0.3
# Shift of an intensity difference by the view, in its standard deviations over all patches: per
# sine of the angle of view, per factor of two in distance, and by image noise. With them ORB's
# usual limits hold: about 30 of 256 bits differ for one view, 64 after some 35 degrees.
_SHIFT_BY_ANGLE = 1.3
_SHIFT_BY_DISTANCE = 0.9
_SHIFT_BY_NOISE = 0.22
# Random part of a corner's strength in one image, against 1 for that between corners: the
# repeatability of the detector.
_STRENGTH_NOISE = 0.5
_STRENGTH_BY_VIEW = 1.0
# Weaker corners are not found.
_MIN_STRENGTH = -0.3
# Share of landmarks that look like another one.
_REPEATED = 0.1
_REPEATED_NOISE = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """An axis-aligned box of the hall: corners (3,) [m]."""

    low: Array
    high: Array


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Points on surfaces.

    Attributes:
        positions_m: (N, 3) in the world frame.
        normals: (N, 3) unit normals, out of the surface.
        own_distance_m: (N,) from where each looks most like itself.
        strength: (N,) of the corner.
        strength_by_view: (N, 3) change of the strength with the view.
        differences: (N, 256) float32 intensity differences whose signs are the descriptor.
    """

    positions_m: Array
    normals: Array
    own_distance_m: Array
    strength: Array
    strength_by_view: Array
    differences: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Hall:
    """The hall; see `build_hall`.

    Attributes:
        landmarks: All landmarks.
        objects: What hides them.
        shift_by_view: (3, 256) float32: how the view shifts intensity differences.
    """

    landmarks: Landmarks
    objects: tuple[Box, ...]
    shift_by_view: NDArray[np.float32]


def build_hall(world: World) -> Hall:
    """Build the hall of a configuration; the same one for the same configuration."""
    rng = np.random.default_rng([1, world.seed])
    objects = _place_objects(world, rng)
    faces = [_inside(world), *(_outside(box) for box in objects)]
    positions, normals = [], []
    for box, outward, skip_floor in faces:
        for axis in range(3):
            for high in (False, True):
                if skip_floor and axis == 2 and not high:
                    continue
                density = world.landmark_density / (1 if axis < 2 or outward > 0 else 3)
                points = _on_face(box, axis, high, density, rng)
                normal = np.zeros(3)
                normal[axis] = outward * (1 if high else -1)
                positions.append(points)
                normals.append(np.tile(normal, (len(points), 1)))
    landmarks = _landmarks(np.concatenate(positions), np.concatenate(normals), rng)
    shift = rng.normal(size=(3, NUM_BITS)) * [
        [_SHIFT_BY_ANGLE],
        [_SHIFT_BY_ANGLE],
        [_SHIFT_BY_DISTANCE],
    ]
    return Hall(landmarks, tuple(objects), shift.astype(np.float32))


def recognisable(hall: Hall, position_m: Array) -> NDArray[np.intp]:
    """Indices of the landmarks that can be recognised from a position (3,), if nothing is between.

    Not too near or far for their size and not too oblique.
    """
    marks = hall.landmarks
    rays = position_m - marks.positions_m
    distance = np.sqrt(np.einsum("ij,ij->i", rays, rays))
    incidence = np.einsum("ij,ij->i", rays, marks.normals)
    ratio = distance / marks.own_distance_m
    return np.flatnonzero(
        (distance > _MIN_DEPTH_M)
        & (incidence > _MIN_COS_INCIDENCE * distance)
        & (ratio > _MIN_DISTANCE_RATIO)
        & (ratio < 1 / _MIN_DISTANCE_RATIO)
    )


def unhidden(hall: Hall, indices: NDArray[np.intp], position_m: Array) -> NDArray[np.intp]:
    """Those of some landmarks that no object hides from a position (3,)."""
    for box in hall.objects:
        rays = hall.landmarks.positions_m[indices] - position_m
        indices = indices[~_hidden_by(box, position_m, rays)]
    return indices


def detect(
    hall: Hall, indices: NDArray[np.intp], position_m: Array, number: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.uint8]]:
    """The strongest of some visible landmarks in one image, as a detector finds them.

    Args:
        hall: The hall.
        indices: Landmarks in the image.
        position_m: (3,) of the camera.
        number: At most so many are found.
        rng: Image noise.

    Returns:
        Indices (K,) of the landmarks found and their descriptors (K, 32).
    """
    marks = hall.landmarks
    view = _view(marks, indices, position_m)
    strength = (
        marks.strength[indices]
        + np.einsum("ij,ij->i", view, marks.strength_by_view[indices])
        + _STRENGTH_NOISE * rng.normal(size=len(indices))
    )
    strongest = np.argsort(-strength, kind="stable")[:number]
    best = np.sort(strongest[strength[strongest] > _MIN_STRENGTH])
    found = indices[best]
    differences = marks.differences[found] + view[best].astype(np.float32) @ hall.shift_by_view
    noise = rng.standard_normal(differences.shape, dtype=np.float32)
    return found, np.packbits(differences + np.float32(_SHIFT_BY_NOISE) * noise > 0, axis=1)


def _view(marks: Landmarks, indices: NDArray[np.intp], position_m: Array) -> Array:
    """(K, 3): sines of the two angles of view, and the distance in factors of two."""
    rays = position_m - marks.positions_m[indices]
    distance = np.linalg.norm(rays, axis=1)
    normals = marks.normals[indices]
    # The two axes of the surface: those of the world that follow its normal's.
    first = np.roll(np.abs(normals), 1, axis=1)
    second = np.roll(np.abs(normals), 2, axis=1)
    along = [np.einsum("ij,ij->i", rays, axis) / distance for axis in (first, second)]
    return np.stack([*along, np.log2(distance / marks.own_distance_m[indices])], axis=1)


def _landmarks(positions: Array, normals: Array, rng: np.random.Generator) -> Landmarks:
    n = len(positions)
    differences = rng.standard_normal((n, NUM_BITS), dtype=np.float32)
    copies = rng.choice(n, size=int(n * _REPEATED), replace=False)
    noise = rng.standard_normal((len(copies), NUM_BITS), dtype=np.float32)
    originals = differences[rng.integers(n, size=len(copies))]
    differences[copies] = originals + np.float32(_REPEATED_NOISE) * noise
    near, far = np.log(_OWN_DISTANCE_M)
    return Landmarks(
        positions,
        normals,
        np.exp(rng.uniform(near, far, size=n)),
        rng.normal(size=n),
        _STRENGTH_BY_VIEW * rng.normal(size=(n, 3)),
        differences,
    )


def _place_objects(world: World, rng: np.random.Generator) -> list[Box]:
    """Boxes along the walls, where no robot walks: in the outer quarter of the hall."""
    half = np.array(world.size_m) / 2
    boxes = []
    for i in range(world.num_objects):
        angle = 2 * np.pi * (i + rng.uniform(0.2, 0.8)) / world.num_objects
        center = 0.85 * half[:2] * [np.cos(angle), np.sin(angle)]
        size = rng.uniform(0.3, 0.1 * world.size_m[0], size=2) / 2
        height = rng.uniform(0.2, 0.6) * world.size_m[2]
        boxes.append(Box(np.append(center - size, 0.0), np.append(center + size, height)))
    return boxes


def _inside(world: World) -> tuple[Box, float, bool]:
    length, width, height = world.size_m
    low, high = np.array([-length / 2, -width / 2, 0.0]), np.array([length / 2, width / 2, height])
    return Box(low, high), -1.0, False


def _outside(box: Box) -> tuple[Box, float, bool]:
    return box, 1.0, True


def _on_face(box: Box, axis: int, high: bool, density: float, rng: np.random.Generator) -> Array:
    extent = np.delete(box.high - box.low, axis)
    points = rng.uniform(box.low, box.high, size=(int(density * extent.prod()), 3))
    points[:, axis] = (box.high if high else box.low)[axis]
    return points


def _hidden_by(box: Box, position_m: Array, rays: Array) -> NDArray[np.bool_]:
    """Whether the ends of rays from a position lie behind the box (slab test).

    Ends on the box itself do not count as hidden: its far sides face away anyway.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        low = (box.low - position_m) / rays
        high = (box.high - position_m) / rays
    near, far = np.fmin(low, high).T, np.fmax(low, high).T
    enter = np.fmax(np.fmax(near[0], near[1]), near[2])
    leave = np.fmin(np.fmin(far[0], far[1]), far[2])
    hidden: NDArray[np.bool_] = (enter < leave) & (leave > 0) & (enter < 1 - 1e-6)
    return hidden
