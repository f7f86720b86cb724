"""Images of a world as a camera sees it, with exact depth."""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.scenario.scenes import Look
from covinz.types import Array, Camera
from covinz_agents.world import lens
from covinz_agents.world.drawing import Drawing
from covinz_agents.world.egl import RenderError
from covinz_agents.world.geometry import World
from covinz_agents.world.painted import paint

__all__ = ["RenderError", "Renderer", "Rendering"]

# Pixels of the drawn views per raw pixel, along each axis: edges are averaged over so many.
_OVERSAMPLING = 1.3


@dataclass(frozen=True, slots=True, eq=False)
class Rendering:
    """An image before the sensor.

    Attributes:
        image: (H, W, 3) float32 BGR linear radiance of the raw (distorted) pixels.
        depth_m: (H, W) float32 depth along the camera's z of what the centre of each raw pixel
            sees; inf for the sky and where the lens sees nothing.
    """

    image: NDArray[np.float32]
    depth_m: NDArray[np.float32]


class Renderer:
    """Draws one world, as it looks on one visit, through one lens. A context manager.

    The same arguments give the same bits on the same machine.

    Raises:
        RenderError: If EGL cannot be had; the message names the packages.
    """

    def __init__(self, world: World, look: Look, camera: Camera) -> None:
        self._camera = camera
        self._views = lens.views(camera, _OVERSAMPLING)
        self._rays = lens.pixel_rays(camera).reshape(-1, 3)
        corners = np.array([face.corner_m for face in world.faces])
        self._normals = np.array([face.normal for face in world.faces])
        self._offsets = np.einsum("fi,fi->f", self._normals, corners)
        self._drawing = Drawing(world, paint(world, look), [view.size_px for view in self._views])

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the context; no image can be drawn afterwards."""
        self._drawing.close()

    def render(self, T_world_cam: Array) -> Rendering:
        """Draw what the camera sees from a pose (4, 4)."""
        height, width = self._camera.height, self._camera.width
        image = np.zeros((height * width, 3), dtype=np.float32)
        depth = np.full(height * width, np.inf, dtype=np.float32)
        T_cam_world = frames.inverse(T_world_cam)
        for view in self._views:
            drawn = self._drawing.draw(view, T_cam_world)
            image[view.pixels] = lens.resample(drawn, view)[:, :3]
            face = _nearest_face(drawn, view)
            depth[view.pixels] = self._depth(face, self._rays[view.pixels], T_world_cam)
        return Rendering(image.reshape(height, width, 3), depth.reshape(height, width))

    def _depth(self, face: NDArray[np.intp], rays: Array, T_world_cam: Array) -> Array:
        """Depth at which rays (N, 3) of the camera meet the planes of faces; -1 is the sky."""
        normals_cam = self._normals @ T_world_cam[:3, :3]
        offsets = self._offsets - self._normals @ T_world_cam[:3, 3]
        with np.errstate(divide="ignore"):
            slope = np.einsum("ni,ni->n", normals_cam[face], rays)
            depth: Array = offsets[face] / slope * rays[:, 2]
        return np.where(face < 0, np.inf, depth)


def _nearest_face(drawn: NDArray[np.float32], view: lens.View) -> NDArray[np.intp]:
    """(N,) numbers of the faces that the raw pixels of a view see."""
    x, y = np.rint(view.x_px).astype(np.intp), np.rint(view.y_px).astype(np.intp)
    face: NDArray[np.intp] = drawn[y, x, 3].astype(np.intp) - 1
    return face
