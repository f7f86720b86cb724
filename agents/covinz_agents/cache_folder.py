"""Where generated textures, baked light and rendered images are kept between runs."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import ModuleType


def cache_folder(name: str, environ: Mapping[str, str] | None = None) -> Path:
    """The folder of a kind of cached files, made if need be.

    ``COVINZ_CACHE``, else ``XDG_CACHE_HOME/covinz``, else ``~/.cache/covinz``; in it `name`.
    Whoever writes there names files by everything that they depend on, so that they are never
    stale, and may find them gone at any time.
    """
    variables = os.environ if environ is None else environ
    if chosen := variables.get("COVINZ_CACHE"):
        root = Path(chosen)
    elif base := variables.get("XDG_CACHE_HOME"):
        root = Path(base) / "covinz"
    else:
        root = Path.home() / ".cache" / "covinz"
    folder = root / name
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def source_digest(modules: Iterable[ModuleType]) -> str:
    """Digest (16 hex digits) of the source of modules: part of the names of what they made."""
    digest = hashlib.blake2b(digest_size=8)
    for module in modules:
        if module.__file__ is None:
            raise ValueError(f"{module.__name__} has no source file")
        digest.update(Path(module.__file__).read_bytes())
    return digest.hexdigest()
