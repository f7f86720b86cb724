"""Pictures of a generated world: from the cache, or rendered by the one renderer of the process."""

from __future__ import annotations

import ast
import functools
import hashlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from covinz.scenario import Look, Sensor
from covinz.types import Array, Camera
from covinz_agents import image_cache
from covinz_agents.cache_folder import cache_folder
from covinz_agents.image_cache import ImageCache
from covinz_agents.source import DatasetError
from covinz_agents.world import renderer
from covinz_agents.world.geometry import World
from covinz_agents.world.renderer import Renderer
from covinz_agents.world.sensor import expose
from covinz_agents.world_digest import digest_faces

# Raise it when images change for another reason than what is digested, e.g. in this module.
_VERSION = 1


@dataclass(frozen=True, slots=True, eq=False)
class Visit:
    """What all pictures of a robot have in common.

    Attributes:
        world: Where.
        look: How the world looks on this visit.
        camera: The lens.
        sensor: What is behind it.
        digest: Of all this and of the renderer's code.
    """

    world: World
    look: Look
    camera: Camera
    sensor: Sensor
    digest: str


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One picture.

    Attributes:
        T_world_cam: (N, 4, 4) poses over the time of exposure, one without motion blur.
        seed: Of the sensor's noise.
    """

    T_world_cam: Array
    seed: int


def visit(world: World, look: Look, camera: Camera, sensor: Sensor) -> Visit:
    """The visit, with its digest."""
    digest = hashlib.blake2b(f"{_VERSION} {renderer_digest()} {world.outdoors}\n".encode())
    digest.update(f"{world.seed} {look.model_dump_json()} {sensor.model_dump_json()}\n".encode())
    digest.update(camera.hash.encode())
    digest_faces(digest, world)
    return Visit(world, look, camera, sensor, digest.hexdigest()[:32])


@functools.cache
def renderer_digest() -> str:
    """Digest of the code that images depend on: a change of it makes new ones."""
    digest = hashlib.blake2b(Path(image_cache.__file__).read_bytes(), digest_size=8)
    for path in renderer_sources():
        digest.update(path.read_bytes())
    return digest.hexdigest()


def renderer_sources() -> tuple[Path, ...]:
    """Files of the package `world` that make images: renderer, sensor and what they import of it.

    What they draw, whoever built it, is part of an image's name by itself.
    """
    files = {path.stem: path for path in Path(renderer.__file__).parent.glob("*.py")}
    found: set[str] = set()
    waiting = ["renderer", "sensor"]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        for node in ast.walk(ast.parse(files[name].read_text())):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                package, _, module = node.module.rpartition(".")
                below = [alias.name for alias in node.names] if module == "world" else []
                named = [module, *below] if package.startswith("covinz_agents") else below
                waiting += [n for n in named if n in files]
    return tuple(sorted(files[name] for name in found))


class Studio:
    """Takes pictures, each once.

    An OpenGL context belongs to the thread that made it and takes room: there is one renderer at
    a time, in a thread of its own. Any thread may ask for pictures.

    Args:
        cache: Where pictures are kept.
    """

    def __init__(self, cache: ImageCache) -> None:
        self._cache = cache
        self._thread = ThreadPoolExecutor(1, "renderer")
        self._open: tuple[str, Renderer] | None = None

    def has(self, visit: Visit, shot: Shot) -> bool:
        """Whether a picture is in the cache."""
        return _key(visit, shot) in self._cache

    def picture(self, visit: Visit, shot: Shot) -> NDArray[np.uint8]:
        """A picture (H, W, 3) BGR.

        Raises:
            RenderError: If the world cannot be drawn on this machine.
            DatasetError: If the cache cannot be written.
        """
        key = _key(visit, shot)
        kept = self._cache.read(key)
        if kept is not None:
            return kept
        return self._thread.submit(self._taken, visit, shot, key).result()

    def prune(self) -> None:
        """Keep the cache within its bounds."""
        self._cache.prune()

    def _taken(self, visit: Visit, shot: Shot, key: str) -> NDArray[np.uint8]:
        renderer = self._renderer(visit)
        light = [renderer.render(T).image for T in shot.T_world_cam]
        exposed = expose(light, visit.sensor, np.random.default_rng(shot.seed))
        try:
            return self._cache.write(key, exposed)
        except OSError as error:
            raise DatasetError(f"cannot keep a rendered image: {error}") from error

    def _renderer(self, visit: Visit) -> Renderer:
        if self._open is None or self._open[0] != visit.digest:
            if self._open is not None:
                self._open[1].close()
                self._open = None
            self._open = (visit.digest, Renderer(visit.world, visit.look, visit.camera))
        return self._open[1]


@functools.cache
def studio() -> Studio:
    """The studio of this process, with the images that are kept between runs."""
    return Studio(ImageCache(cache_folder("images")))


def _key(visit: Visit, shot: Shot) -> str:
    digest = hashlib.blake2b(f"{visit.digest} {shot.seed}\n".encode(), digest_size=16)
    digest.update(shot.T_world_cam.astype("<f8").tobytes())
    return digest.hexdigest()
