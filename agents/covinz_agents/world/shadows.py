"""What a light sees of a world: depth maps, by which surfaces know whether it reaches them."""

from __future__ import annotations

from types import TracebackType

import moderngl
import numpy as np
from numpy.typing import NDArray

from covinz.types import Array
from covinz_agents.world.egl import open_context
from covinz_agents.world.geometry import World

# Of the light's view: pixels along a side of the cube around a point; from afar, pixels of this
# size, up to a number. [m]
_CUBE_PX = 256
_FAR_M, _MOST_FAR_PX = 0.06, 2048
_NEAR_M, _MAX_M = 0.02, 500.0
# A surface nearer to the light by less than this does not shade. [m, share of the distance]
_SLACK_M, _SLACK = 0.04, 0.01

_VERTEX = """
#version 330
uniform mat4 T_clip_world;
uniform vec4 depth_of_world;
in vec3 position;
out float depth;
void main() {
    gl_Position = T_clip_world * vec4(position, 1.0);
    depth = dot(depth_of_world, vec4(position, 1.0));
}
"""
_FRAGMENT = """
#version 330
in float depth;
out float seen;
void main() { seen = depth; }
"""


class ShadowMaps:
    """Draws depth maps of one world; a context manager.

    Raises:
        RenderError: If there is no EGL.
    """

    def __init__(self, world: World) -> None:
        corners = np.array(
            [
                [f.corner_m, f.corner_m + f.u_m, f.corner_m + f.v_m, f.corner_m + f.u_m + f.v_m]
                for f in world.faces
            ]
        )
        flat = corners.reshape(-1, 3)
        self._middle = (flat.min(axis=0) + flat.max(axis=0)) / 2
        self._radius = float(np.linalg.norm(flat - self._middle, axis=1).max())
        self._far_px = int(np.clip(2 * self._radius / _FAR_M, 64, _MOST_FAR_PX))
        index = 4 * np.arange(len(corners))[:, None] + np.array([0, 1, 2, 2, 1, 3])
        self._gl = open_context()
        with self._gl:
            self._program = self._gl.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
            self._faces = self._gl.vertex_array(
                self._program,
                [(self._gl.buffer(flat.astype("f4").tobytes()), "3f", "position")],
                index_buffer=self._gl.buffer(index.astype("i4").tobytes()),
            )
            self._targets = {px: self._target(px) for px in (_CUBE_PX, self._far_px)}

    def __enter__(self) -> ShadowMaps:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._gl.release()

    def seen_from_point(self, point_m: Array, normal: Array, at_m: Array) -> NDArray[np.bool_]:
        """(N,) whether positions (N, 3) before a point are in its sight."""
        axes = _axes(normal)
        local = (at_m - point_m) @ axes.T
        side = _side(local)
        seen = np.zeros(len(at_m), dtype=bool)
        for number, turn in enumerate(_HALF_CUBE):
            here = np.flatnonzero(side == number)
            if len(here) == 0:
                continue
            turned = local[here] @ turn.T
            rows = turn @ axes
            depth = self._perspective(point_m, rows)
            pixel = (0.5 + 0.5 * turned[:, :2] / turned[:, 2:]) * _CUBE_PX
            seen[here] = _reached(depth, pixel, turned[:, 2])
        return seen

    def seen_from_afar(self, towards: Array, at_m: Array) -> NDArray[np.bool_]:
        """(N,) whether positions (N, 3) are in sight from far away in a direction."""
        axes = _axes(-towards)
        depth = self._orthographic(axes)
        local = (at_m - self._middle) @ axes.T
        pixel = (0.5 + 0.5 * local[:, :2] / self._radius) * self._far_px
        # The plane of the map lies a radius before the middle.
        return _reached(depth, pixel, local[:, 2] + self._radius)

    def _perspective(self, point_m: Array, rows: Array) -> NDArray[np.float32]:
        world = np.column_stack([rows, -rows @ point_m])
        clip = np.zeros((4, 4))
        clip[0], clip[1], clip[3] = world[0], world[1], world[2]
        clip[2] = world[2] * (_MAX_M + _NEAR_M) / (_MAX_M - _NEAR_M)
        clip[2, 3] -= 2 * _MAX_M * _NEAR_M / (_MAX_M - _NEAR_M)
        return self._draw(clip, world[2], _CUBE_PX)

    def _orthographic(self, axes: Array) -> NDArray[np.float32]:
        world = np.column_stack([axes, -axes @ self._middle])
        clip = np.vstack([world / self._radius, [0, 0, 0, 1]])
        depth = world[2] + [0, 0, 0, self._radius]
        return self._draw(clip, depth, self._far_px)

    def _draw(self, clip: Array, depth: Array, size_px: int) -> NDArray[np.float32]:
        with self._gl:
            target = self._targets[size_px]
            target.use()
            self._gl.enable_only(moderngl.DEPTH_TEST)
            target.clear(1e9, depth=1.0)
            for name, value in (("T_clip_world", clip.T), ("depth_of_world", depth)):
                uniform = self._program[name]
                assert isinstance(uniform, moderngl.Uniform)
                uniform.write(np.ascontiguousarray(value, dtype="f4").tobytes())
            self._faces.render()
            pixels = target.read(components=1, dtype="f4")
        return np.frombuffer(pixels, dtype=np.float32).reshape(size_px, size_px)

    def _target(self, size_px: int) -> moderngl.Framebuffer:
        size = size_px, size_px
        return self._gl.framebuffer(
            self._gl.texture(size, 1, dtype="f4"), self._gl.depth_renderbuffer(size)
        )


# Ahead and to four sides: rows are axes whose third looks that way.
_HALF_CUBE = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
        [[0, -1, 0], [0, 0, 1], [-1, 0, 0]],
        [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
        [[0, 0, 1], [-1, 0, 0], [0, -1, 0]],
    ],
    dtype=float,
)


def _side(local: Array) -> NDArray[np.intp]:
    """(N,) which part of the half cube each direction (N, 3) goes through."""
    along = np.einsum("sj,nj->ns", _HALF_CUBE[:, 2], local)
    return np.asarray(along.argmax(axis=1), dtype=np.intp)


def _axes(forward: Array) -> Array:
    """(3, 3) rows x, y, z of a frame whose z looks forward."""
    helper = np.array([1.0, 0, 0]) if abs(forward[0]) < 0.7 else np.array([0, 1.0, 0])
    x = np.cross(helper, forward)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(forward, x), forward])


def _reached(depth: NDArray[np.float32], pixel: Array, distance: Array) -> NDArray[np.bool_]:
    last = len(depth) - 1
    column, row = np.clip(pixel, 0, last).astype(np.intp).T
    reached: NDArray[np.bool_] = distance <= depth[row, column] * (1 + _SLACK) + _SLACK_M
    return reached
