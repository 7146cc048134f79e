"""Pictures and videos of tasks, policies and demonstrations.

Names are loaded on first use, because `Scene` needs no learner.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from earl_jax.rendering.api import render
    from earl_jax.rendering.scenes import Scene, cameras
    from earl_jax.rendering.videos import VideoLog

_HOME = {"Scene": "scenes", "VideoLog": "videos", "cameras": "scenes", "render": "api"}
__all__ = ["Scene", "VideoLog", "cameras", "render"]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"earl_jax.rendering.{_HOME[name]}"), name)
    raise AttributeError(f"module 'earl_jax.rendering' has no attribute {name!r}")
