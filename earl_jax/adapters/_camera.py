"""Draws environment states for the adapters."""

from typing import Any

import numpy as np

from earl_jax.envs import Env, State


class Camera:
    """Draws states of `env`, uint8 [height, width, 3], with a scene that is made for the first picture."""

    def __init__(self, env: Env, height: int, width: int):
        self.env = env
        self.size = (height, width)
        self._scene: Any = None

    def __call__(self, env_state: State) -> np.ndarray:
        """Return the picture of one `env_state`. Errors as `earl_jax.rendering.Scene`."""
        from earl_jax.rendering.scenes import Scene

        self._scene = self._scene or Scene(self.env, self.size)
        return self._scene.image(env_state)

    def close(self) -> None:
        """Release the resources of the graphics driver."""
        if self._scene is not None:
            self._scene.close()
        self._scene = None
