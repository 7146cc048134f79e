"""The common part of gymnasium's single and vector environments: a session with its state, infos and pictures."""

from typing import Any

import gymnasium
import numpy as np

from earl_jax.adapters._session import Outputs, Session, checked_array, jitted
from earl_jax.envs import State
from earl_jax.errors import InputError
from earl_jax.options.values import Interval, require
from earl_jax.protocol import ProtocolState

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}
PIXELS = Interval("[1, 16384]", whole=True)
"""The widths and heights of pictures that graphics drivers support."""


class GymnasiumSession:
    """A `Session` under jit, for one lane or for all lanes of a vector environment (`has_lanes`)."""

    metadata = METADATA
    has_lanes = False

    def _open(self, session: Session, render_mode: str | None, width: int, height: int) -> None:
        """Take over `session`, which has no state before the first reset.

        Raises:
            ValueError: the render mode is unknown, or a size is not a number of pixels; the message has the choices.
        """
        require("width", width, PIXELS)
        require("height", height, PIXELS)
        view = session.env.view
        pictures = {"render_modes": []} if view is None else {"render_fps": round(1 / view.dt)}
        self.metadata = {**self.metadata, **pictures}
        modes = ", ".join(["None", *self.metadata["render_modes"]])
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode {render_mode!r} is not one of the modes of {session.env.name}: {modes}")
        self.session, self.render_mode = session, render_mode
        self._state: ProtocolState | None = None
        self._scene: Any = None
        self._picture_size = (height, width)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for copies and pickles: everything except the scene of the pictures, which is made again."""
        return {**self.__dict__, "_scene": None}

    @property
    def state(self) -> ProtocolState:
        """The current state of the lifetime or the episode; in a vector environment, of all lanes.

        Raises:
            gymnasium.error.ResetNeeded: there was no reset yet.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("call reset() first")
        return self._state

    def _call(self, name: str, *arguments: Any) -> Any:
        """Return the result of the session's method `name`, of all lanes if there are several."""
        return jitted(self.session, name, self.has_lanes)(*arguments)

    def _infos(self, outputs: Outputs) -> dict[str, np.ndarray]:
        """Return the infos of one lane, or of all with a leading axis."""
        values = {
            "goal": np.array(outputs.obs[..., self.session.env.state_size :]),
            "success": np.array(outputs.success),
            "interventions": np.array(outputs.interventions, np.int64),
        }
        if self.session.is_training:
            values["next_obs"] = np.array(outputs.next_obs)
        else:
            values["is_success"] = np.array(outputs.reached)
        if self.session.starts == "wide":
            values["is_success_wide"] = np.array(outputs.reached)
        return values

    def _change_goal(self, name: str, goal: np.ndarray | None, shape: tuple[int, ...], mask: Any) -> np.ndarray:
        """Return observations, with `goal` (an argument called `name`) or, if None, with a new goal, where `mask`."""
        goal = None if goal is None else checked_array(name, goal, shape)
        self._state = self._call("set_goal", self.state, goal, mask)
        return np.array(self.state.env_state.obs)

    def _picture(self, env_state: State) -> np.ndarray:
        """Return the picture of one `env_state`; the first call makes the scene."""
        from earl_jax.rendering.scenes import Scene

        self._scene = self._scene or Scene(self.session.env, self._picture_size)
        return self._scene.image(env_state)

    def close_extras(self, **_: Any) -> None:
        """Release the resources of the pictures."""
        if self._scene is not None:
            self._scene.close()
        self._scene = None


def draw_seed(generator: np.random.Generator) -> np.uint32:
    """Return a seed of a session, drawn from gymnasium's generator."""
    return generator.integers(2**32, dtype=np.uint32)
