"""What a generated world is made of: textured parallelograms, lamps and sky."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from covinz.types import Array, frozen_array


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A textured parallelogram, visible from the side to which its normal points.

    Every face of a world has a texture of its own, so that no two places look alike.

    Attributes:
        corner_m: (3,) its first corner in the world frame.
        u_m: (3,) from there along the texture's x axis.
        v_m: (3,) from there along the texture's y axis (down, as text is read).
        material: Name of a family of textures.
    """

    corner_m: Array
    u_m: Array
    v_m: Array
    material: str

    def __post_init__(self) -> None:
        for name in ("corner_m", "u_m", "v_m"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (3,)))

    @property
    def normal(self) -> Array:
        """(3,) unit normal: towards the viewer who reads the texture the right way round."""
        across = np.cross(self.v_m, self.u_m)
        normal: Array = across / np.linalg.norm(across)
        return normal


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A world to be rendered.

    Attributes:
        faces: Everything that can be seen.
        low_m: (3,) lower corner of the space in which robots may be.
        high_m: (3,) its upper corner.
        outdoors: Lit by sun and sky, not by lamps.
        seed: Seed of its textures; each face draws from its own stream.
    """

    faces: tuple[Face, ...]
    low_m: Array
    high_m: Array
    outdoors: bool
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("low_m", "high_m"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (3,)))

    @property
    def digest(self) -> str:
        """Content hash (16 hex digits): part of the names of files made from this world."""
        digest = hashlib.blake2b(f"{self.seed} {self.outdoors}\n".encode(), digest_size=8)
        for face in self.faces:
            digest.update(f"{face.material}\n".encode())
            for side in (face.corner_m, face.u_m, face.v_m):
                digest.update(side.astype("<f8").tobytes())
        return digest.hexdigest()
