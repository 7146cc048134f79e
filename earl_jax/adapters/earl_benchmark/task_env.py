"""A task with old gym's `step`, which returns four values, as in the original's environments."""

import dataclasses
from typing import Any

import numpy as np

from earl_jax.adapters._session import jitted
from earl_jax.adapters.gymnasium import ResetFreeEnv
from earl_jax.envs import Env
from earl_jax.errors import InputError
from earl_jax.options.values import LARGEST_INT, SEED, require


class TaskEnv:
    """A task that keeps its state until the caller resets it; `done` is true only if the simulation breaks.

    In that case the observation is the one before the step. `info` is `{"success": bool}`.
    """

    reward_range = (-np.inf, np.inf)
    spec = None

    def __init__(self, task: Env):
        """Make the env of `task`, with gymnasium's spaces."""
        task = dataclasses.replace(task, eval_horizon=LARGEST_INT)
        self._env = ResetFreeEnv(task, mode="eval", render_mode="rgb_array" if task.view else None)
        self._seed: int | None = int(np.random.randint(2**31))
        self.observation_space = self._env.observation_space
        self.action_space = self._env.action_space
        self.metadata = self._env.metadata

    def reset(self) -> np.ndarray:
        """Return the first observation [s + g] of an attempt: s0 ~ rho and a task goal."""
        obs, _ = self._env.reset(seed=self._seed)
        self._seed = None
        return obs

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict]:
        """Return observation [s + g], reward, done and info after one control step with `action [a]`.

        Raises:
            ValueError: the action has another shape or is not finite.
        """
        obs, reward, terminated, truncated, info = self._env.step(action)
        return obs, reward, terminated or truncated, {"success": info["success"]}

    def get_next_goal(self) -> np.ndarray:
        """Return a random task goal [g], from numpy's global generator; the current goal stays."""
        goals = self._env.session.env.goal_states
        return np.array(goals[np.random.randint(len(goals))])

    def reset_goal(self, goal: np.ndarray | None = None) -> np.ndarray:
        """Return the observation [s + g] with `goal [g]`, or a random task goal (the original returns None)."""
        return self._env.set_goal(goal)

    @property
    def goal(self) -> np.ndarray:
        """The current goal [g]."""
        return np.array(self._env.state.env_state.info["goal"])

    def is_successful(self, obs: np.ndarray | None = None) -> Any:
        """Return whether `obs [..., s + g]`, or the current state, has reached its goal: bool, or bool [...].

        Raises:
            ValueError: `obs` has another size.
        """
        return self._evaluate("success", obs)

    def compute_reward(self, obs: np.ndarray | None = None) -> Any:
        """Return the reward of arriving in `obs [..., s + g]`, or that of the current state: a number, or [...].

        The current state's reward is exact, even if it depends on more than `obs`. Errors as `is_successful`.
        """
        if obs is not None:
            return self._evaluate("reward", obs)
        state = self._env.state.env_state
        return jitted(self._env.session.env, "goal_reward")(state, state.info["goal"]).item()

    def _evaluate(self, name: str, obs: np.ndarray | None) -> Any:
        current = np.asarray(self._env.state.env_state.obs if obs is None else obs, np.float32)
        task = self._env.session.env
        if current.shape[-1:] != (task.observation_size,):
            raise InputError(f"obs has shape {current.shape}, this task takes (..., {task.observation_size})")
        value = np.array(jitted(task, name)(current))
        return value if value.ndim else value.item()

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the next reset with `seed`, or from numpy's global generator; return the seed in a list.

        Raises:
            ValueError: the seed is not a whole number from 0 to 2^32 - 1.
        """
        seed = np.random.randint(2**31) if seed is None else seed
        require("seed", seed, SEED)
        self._seed = int(seed)
        return [self._seed]

    def render(self, mode: str = "rgb_array") -> np.ndarray | None:
        """Return a picture [480, 640, 3], uint8.

        Raises:
            ValueError: the `mode` is not `rgb_array` (there is no window), or the task has no pictures.
        """
        if mode != self._env.render_mode:
            raise InputError(f"render mode {mode!r} is not supported; this task has {self._env.render_mode}")
        return self._env.render()

    def close(self) -> None:
        """Release the resources of the pictures."""
        self._env.close()

    @property
    def unwrapped(self) -> "TaskEnv":
        """This env itself, because it wraps no other."""
        return self
