"""A world's faces and textures in an OpenGL context, drawn into perspective views."""

from __future__ import annotations

from collections.abc import Sequence

import moderngl
import numpy as np
from numpy.typing import NDArray

from covinz import frames
from covinz.types import Array
from covinz_agents.world.egl import open_context
from covinz_agents.world.geometry import World
from covinz_agents.world.lens import View
from covinz_agents.world.painted import Painted

_NEAR_M, _FAR_M = 0.05, 1000.0

_VERTEX = """
#version 330
uniform mat4 T_clip_world;
in vec3 position;
in vec3 texel;
in float number;
out vec3 at;
flat out float face;
void main() {
    gl_Position = T_clip_world * vec4(position, 1.0);
    at = texel;
    face = number;
}
"""
# The number in the alpha channel says which face it is, from 1 on; 0 is the sky.
# Textures hold the square root of radiance: fine steps in the dark, as eyes see.
_FACE = """
#version 330
uniform sampler2DArray textures;
in vec3 at;
flat in float face;
out vec4 colour;
void main() {
    vec3 root = texture(textures, at, -0.5).rgb;
    colour = vec4(root * root, face);
}
"""
_NOTHING = """
#version 330
void main() {}
"""
_SKY_VERTEX = """
#version 330
uniform mat3 R_world_ndc;
in vec2 corner;
out vec3 ray;
void main() {
    gl_Position = vec4(corner, 1.0, 1.0);
    ray = R_world_ndc * vec3(corner, 1.0);
}
"""
_SKY = """
#version 330
uniform sampler2D clouds;
uniform vec3 zenith;
uniform vec3 horizon;
uniform vec3 cloud;
in vec3 ray;
out vec4 colour;
void main() {
    float up = max(normalize(ray).z, 0.0);
    vec3 clear = mix(horizon, zenith, sqrt(up));
    float cover = texture(clouds, 0.15 * normalize(ray).xy / (up + 0.15)).r;
    colour = vec4(mix(clear, cloud, cover * smoothstep(0.0, 0.15, up)), 0.0);
}
"""


class Drawing:
    """An OpenGL context that holds one world as it looks on one visit.

    Raises:
        RenderError: If there is no EGL.
    """

    def __init__(self, world: World, painted: Painted, sizes_px: Sequence[tuple[int, int]]) -> None:
        self._gl = open_context()
        with self._gl:
            self._colour = self._gl.program(vertex_shader=_VERTEX, fragment_shader=_FACE)
            self._depth = self._gl.program(vertex_shader=_VERTEX, fragment_shader=_NOTHING)
            self._sky = self._gl.program(vertex_shader=_SKY_VERTEX, fragment_shader=_SKY)
            self._draw_sky = self._sky_quad(painted)
            layers = painted.layers
            self._vertices = self._gl.buffer(_vertices(world, layers).tobytes())
            self._draw_depth = self._faces(self._depth, range(len(world.faces)), ["position"])
            self._batches = [
                (self._texture(batch.images), self._faces(self._colour, batch.faces, _ALL))
                for batch in painted.batches
            ]
            self._targets = {size: self._target(size) for size in set(sizes_px)}

    def close(self) -> None:
        """Release everything; nothing can be drawn afterwards."""
        self._gl.release()

    def draw(self, view: View, T_cam_world: Array) -> NDArray[np.float32]:
        """Draw a view; (height, width, 4) BGR radiance, and 1 + the number of the face.

        The number is 0 where there is sky.
        """
        clip = _clip_from_view(view)
        T_view_world = frames.transform(view.R_view_cam, np.zeros(3)) @ T_cam_world
        with self._gl:
            target = self._targets[view.size_px]
            target.use()
            self._gl.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            target.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
            matrix = (clip @ T_view_world).astype("f4").T.tobytes()
            for program in (self._depth, self._colour):
                _uniform(program, "T_clip_world").write(matrix)
            self._draw_faces(target)
            self._draw_background(clip, T_view_world)
            pixels = target.read(components=4, dtype="f4")
        width, height = view.size_px
        return np.frombuffer(pixels, dtype=np.float32).reshape(height, width, 4)

    def _draw_faces(self, target: moderngl.Framebuffer) -> None:
        """Depth first, so that only what is seen is textured."""
        self._gl.depth_func = "<"
        target.color_mask = False, False, False, False
        self._draw_depth.render()
        target.color_mask = True, True, True, True
        self._gl.depth_func = "<="
        for texture, faces in self._batches:
            texture.use(0)
            faces.render()

    def _draw_background(self, clip: Array, T_view_world: Array) -> None:
        (ax, bx), (ay, by) = clip[0, [0, 2]], clip[1, [1, 2]]
        view_from_ndc = np.array([[1 / ax, 0, -bx / ax], [0, 1 / ay, -by / ay], [0, 0, 1]])
        R_world_ndc = T_view_world[:3, :3].T @ view_from_ndc
        _uniform(self._sky, "R_world_ndc").write(R_world_ndc.astype("f4").T.tobytes())
        self._clouds.use(0)
        self._draw_sky.render(moderngl.TRIANGLE_STRIP)

    def _sky_quad(self, painted: Painted) -> moderngl.VertexArray:
        clouds, sky = painted.sky.clouds, painted.sky
        height, width = clouds.shape
        self._clouds = self._gl.texture((width, height), 1, clouds.tobytes(), alignment=1)
        self._clouds.build_mipmaps()
        for name in ("zenith", "horizon", "cloud"):
            _uniform(self._sky, name).value = tuple(getattr(sky, name))
        corners = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]], dtype="f4")
        return self._gl.vertex_array(self._sky, [(self._gl.buffer(corners), "2f", "corner")])

    def _faces(
        self, program: moderngl.Program, numbers: Sequence[int], attributes: Sequence[str]
    ) -> moderngl.VertexArray:
        quad = np.array([0, 1, 2, 2, 1, 3], dtype="i4")
        index = (4 * np.asarray(numbers, dtype="i4")[:, None] + quad).astype("i4")
        layout = "3f 3f 1f" if len(attributes) == 3 else "3f 16x"
        return self._gl.vertex_array(
            program,
            [(self._vertices, layout, *attributes)],
            index_buffer=self._gl.buffer(index.tobytes()),
        )

    def _texture(self, images: NDArray[np.uint8]) -> moderngl.TextureArray:
        layers, height, width, channels = images.shape
        texture = self._gl.texture_array(
            (width, height, layers), channels, images.tobytes(), alignment=1
        )
        texture.repeat_x = texture.repeat_y = False
        texture.build_mipmaps()
        texture.filter = moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR
        return texture

    def _target(self, size_px: tuple[int, int]) -> moderngl.Framebuffer:
        return self._gl.framebuffer(
            self._gl.texture(size_px, 4, dtype="f4"), self._gl.depth_renderbuffer(size_px)
        )


_ALL = ("position", "texel", "number")


def _uniform(program: moderngl.Program, name: str) -> moderngl.Uniform:
    member = program[name]
    if not isinstance(member, moderngl.Uniform):
        raise TypeError(f"{name} is no uniform")
    return member


def _vertices(world: World, layers: Sequence[int]) -> NDArray[np.float32]:
    """(F, 4, 7) position, texture coordinates and layer, and number of every corner."""
    values = np.empty((len(world.faces), 4, 7), dtype=np.float32)
    for number, face in enumerate(world.faces):
        for corner, (u, v) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
            at = face.corner_m + u * face.u_m + v * face.v_m
            values[number, corner] = (*at, u, v, layers[number], number + 1)
    return values


def _clip_from_view(view: View) -> Array:
    """(4, 4) projection into OpenGL's clip space; the image's first row is drawn first.

    OpenGL's pixel centres lie at halves, ours at whole numbers.
    """
    (width, height), (cx, cy), f = view.size_px, view.center_px, view.focal_px
    span = _FAR_M - _NEAR_M
    return np.array(
        [
            [2 * f / width, 0, 2 * (cx + 0.5) / width - 1, 0],
            [0, 2 * f / height, 2 * (cy + 0.5) / height - 1, 0],
            [0, 0, (_FAR_M + _NEAR_M) / span, -2 * _FAR_M * _NEAR_M / span],
            [0, 0, 1, 0],
        ]
    )
