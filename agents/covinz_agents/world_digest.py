"""What a generated world is made of, as part of the names of things that were made from it."""

from __future__ import annotations

import hashlib

from covinz_agents.world.geometry import World


def digest_faces(digest: hashlib.blake2b, world: World) -> None:
    """Add all surfaces of a world to a digest."""
    for face in world.faces:
        digest.update(face.material.encode())
        for side in (face.corner_m, face.u_m, face.v_m):
            digest.update(side.astype("<f8").tobytes())
