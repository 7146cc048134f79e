"""Pictures and videos of tasks, policies and demonstrations."""

from earl_jax.rendering.api import render as render
from earl_jax.rendering.scenes import Scene as Scene, cameras as cameras
from earl_jax.rendering.videos import VideoLog as VideoLog
