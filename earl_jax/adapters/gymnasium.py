"""The tasks as gymnasium environments: `earl_jax/SawyerDoor-v0` and so on, one lane or many lanes in one program.

Importing this module registers the ids, and `gymnasium.make("earl_jax.adapters.gymnasium:earl_jax/SawyerDoor-v0")`
imports it. Since version 1.0, gymnasium loads no plugins by itself.
"""

from typing import Any

import gymnasium
import jax
import numpy as np

from earl_jax.adapters._gymnasium_session import GymnasiumSession, draw_seed
from earl_jax.adapters._gymnasium_vector import ResetFreeVectorEnv  # noqa: F401
from earl_jax.adapters._session import Outputs, Session, checked_array
from earl_jax.envs import Env, list_envs
from earl_jax.errors import InputError, brief


def env_id(name: str) -> str:
    """Return gymnasium's id of the task `name`: `earl_jax/SawyerDoor-v0` for `sawyer_door`."""
    return f"earl_jax/{''.join(part.capitalize() for part in name.split('_'))}-v0"


def register_envs() -> None:
    """Register an id for each task of `list_envs()`; existing ids stay as they are.

    Call it again for tasks that `register_env` added after this module was imported.
    """
    for name in list_envs():
        if env_id(name) not in gymnasium.registry:
            single, vector = f"{__name__}:ResetFreeEnv", f"{__name__}:ResetFreeVectorEnv"
            gymnasium.register(env_id(name), single, kwargs={"task": name}, vector_entry_point=vector)


class ResetFreeEnv(GymnasiumSession, gymnasium.Env):
    """A task as one reset-free lifetime (`mode="train"`) or as evaluation episodes (`mode="eval"`).

    A lifetime is never truncated. It terminates only when a budget for help is spent. Hard interventions happen inside
    `step`, every H_T steps, and are counted. `reset()` without a seed is another intervention; `reset(seed=...)` starts
    a new lifetime. The task goal changes when it is reached (sparse rewards), or else after `attempt_steps`, and at
    interventions, as for naive RL; with `setting="continuing"` it changes only on a schedule. With `set_goal` the
    caller chooses the goals. Episodes start from s0 ~ rho with one goal each and are truncated after H_E steps, or if
    the simulation breaks.

    `info` contains the current `goal [g]`; `success`: whether the step reached the goal that the agent pursued; and the
    number of `interventions` so far. In a life it has `next_obs`: where the step led, under its own goal. Bootstrap from
    it, since the returned observation can follow an intervention or have a new goal. In episodes it has `is_success`:
    whether any step so far was a success. With `starts="wide"`, `is_success_wide` repeats `is_success`, so that a log can
    tell both kinds of episodes apart.
    """

    def __init__(
        self, task: str | Env, *, render_mode: str | None = None, width: int = 640, height: int = 480, **options: Any
    ):
        """Make the environment.

        Args:
            task: a name of `list_envs()` or an `Env`.
            render_mode: `rgb_array`, or None for no pictures.
            width: width of a picture in pixels.
            height: height of a picture in pixels.
            options: `mode`; `setting`: `deployment`, `continuing`, or an object of `earl_jax.protocol` with its own
                interventions and budget; `attempt_steps`; `starts` of episodes: `initial`, `uniform` or `wide`; and
                options of the task: `reward_type`, `engine`, `train_horizon` and so on.

        Raises:
            ValueError: a mode, setting, option or name is unknown; the message lists the choices.
        """
        self._open(Session.of(task, **options), render_mode, width, height)
        env = self.session.env
        self.observation_space, self.action_space = env.observation_space, env.action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Return the first observation [s + g] and info of a lifetime or an episode, or those after an intervention."""
        super().reset(seed=seed)
        if options:
            raise InputError(f"reset takes no options, not {brief(options)}; set_goal chooses a goal")
        if seed is None and self._state is not None:
            self._state, outputs = self._call("reset", self._state)
        else:
            self._state, outputs = self._call("start", draw_seed(self.np_random))
        obs, *_, info = self._returned(outputs)
        return obs, info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Return observation [s + g], reward, terminated, truncated and info after one control step with `action [a]`.

        Raises:
            ValueError: the action has another shape or is not finite.
        """
        action = checked_array("action", action, (self.session.env.action_size,))
        self._state, outputs = self._call("step", self.state, action)
        return self._returned(outputs)

    def _returned(self, outputs: Outputs) -> tuple[np.ndarray, float, bool, bool, dict]:
        outputs = jax.device_get(outputs)
        values = self._infos(outputs)
        info = {name: value if value.ndim else value.item() for name, value in values.items()}
        return np.array(outputs.obs), float(outputs.reward), bool(outputs.terminated), bool(outputs.truncated), info

    def set_goal(self, goal: np.ndarray | None = None) -> np.ndarray:
        """Return the observation [s + g] with `goal [g]`, which stays until the next `set_goal` or `reset`.

        Without `goal`, the environment draws a task goal and again changes goals by its own rules.

        Raises:
            ValueError: the goal has another shape or is not finite.
        """
        return self._change_goal("goal", goal, (self.session.env.goal_size,), True)

    def render(self) -> np.ndarray | None:
        """Return a picture of the current state, uint8 [height, width, 3], or None without a render mode."""
        return None if self.render_mode is None else self._picture(self.state.env_state)

    def close(self) -> None:
        """Release the resources of the pictures."""
        self.close_extras()


register_envs()
