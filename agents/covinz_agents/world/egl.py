"""An OpenGL context without a screen, on the graphics card or on the CPU (Mesa's llvmpipe)."""

from __future__ import annotations

from typing import Any

import moderngl

from covinz_agents.source import DatasetError

_ADVICE = (
    "generated worlds are drawn with OpenGL through EGL; on Debian or Ubuntu: "
    "apt-get install libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri (a graphics card that refuses "
    "may be passed over with LIBGL_ALWAYS_SOFTWARE=1)"
)

# moderngl passes these on; its stubs mistake the keywords for a mapping.
_EGL: Any = {"backend": "egl"}


class RenderError(DatasetError):
    """A generated world cannot be drawn on this machine; the message says what is missing."""


def open_context() -> moderngl.Context:
    """A context of its own, to be released by the caller.

    Raises:
        RenderError: If EGL or its drivers are missing.
    """
    try:
        return moderngl.create_context(standalone=True, require=330, **_EGL)
    # moderngl raises Exception itself for whatever goes wrong.
    except Exception as error:
        raise RenderError(f"{error}: {_ADVICE}") from error
