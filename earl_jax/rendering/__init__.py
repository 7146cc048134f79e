"""Pictures and videos of tasks, policies and demonstrations.

Names are loaded on first use, because `Scene` needs no learner.
"""

from typing import TYPE_CHECKING

from earl_jax.options import lazy

if TYPE_CHECKING:
    from earl_jax.rendering.api import render
    from earl_jax.rendering.scenes import Scene, cameras
    from earl_jax.rendering.videos import VideoLog

__all__ = ["Scene", "VideoLog", "cameras", "render"]
__getattr__ = lazy.attributes(__name__, {"api": "render", "scenes": "Scene cameras", "videos": "VideoLog"})
