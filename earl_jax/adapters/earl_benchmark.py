"""The interface of the original benchmark: `from earl_jax.adapters import earl_benchmark` replaces the original import.

Behaviour follows the released `EARLEnvs` and its wrappers (github.com/architsharma97/earl_benchmark). Docstrings list
the differences; docs/environments.md has those of the tasks.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from earl_jax.adapters.gymnasium import ResetFreeEnv
from earl_jax.envs import Env, make
from earl_jax.errors import InputError
from earl_jax.options.values import LARGEST_INT
from earl_jax.protocol import Continuing, with_explicit_horizon

ORIGINAL_NAMES = {
    "tabletop_manipulation": "tabletop_organization",
    "kitchen": "franka_kitchen",
    "minitaur": "minitaur_pen",
}
"""The original's names of tasks that have another name in `earl_jax`; both names work."""
Demonstrations = dict[str, np.ndarray]


class EARLEnvs:
    """A train and an eval env of one task, with its goals, initial states and demonstrations.

    Without a `reward_type` the task's own is used: sparse for tabletop, door and peg as in the original, dense for the
    others (in the original, the kitchen refuses `sparse`, which is the default, and the Minitaur ignores it).
    Randomness comes from numpy's global generator at construction, so that `np.random.seed` in a script works as
    before.
    """

    def __init__(
        self,
        env_name: str,
        reward_type: str | None = None,
        reset_train_env_at_goal: bool = False,
        setup_as_lifelong_learning: bool = False,
        **options: Any,
    ):
        """Make the envs.

        Args:
            env_name: a name of the original (`tabletop_manipulation`, `sawyer_door`, `sawyer_peg`, `kitchen`,
                `minitaur`) or of `list_envs()`.
            reward_type: `sparse` or `dense`.
            reset_train_env_at_goal: start the train env at the goal (door and peg; the original's tabletop can too, and
                its other tasks ignore the option).
            setup_as_lifelong_learning: only a train env, whose goal changes every `goal_change_frequency` steps.
            options: the original's `train_horizon`, `eval_horizon`, `num_initial_state_samples`,
                `goal_change_frequency`, `wide_init_distr` (only tabletop uses it, as in the original) and
                `kitchen_task`, and options of the task such as `engine`.

        Raises:
            ValueError: an unknown name or option (the original ignores unknown options), or one that this task lacks.
        """
        self._samples = options.pop("num_initial_state_samples", None)
        continuing = Continuing(goal_change=options.pop("goal_change_frequency", None))
        name = ORIGINAL_NAMES.get(env_name, env_name)
        task_options = _task_options(name, reward_type, options)
        self._task = self._train_task = make(name, **task_options)
        self._lifelong = with_explicit_horizon(continuing, self._task, task_options)
        if reset_train_env_at_goal:
            if not hasattr(self._task, "reset_at_goal"):
                raise InputError(f"{self._task.name} cannot start at its goal; sawyer_door and sawyer_peg can")
            self._train_task = dataclasses.replace(self._task, **{"reset_at_goal": True})
        self._train = self.get_train_env(setup_as_lifelong_learning)
        self._eval = None if setup_as_lifelong_learning else self.get_eval_env()

    def get_envs(self) -> "PersistentEnv | tuple[PersistentEnv, PersistentEnv]":
        """Return the train and the eval env, or for lifelong learning the train env alone."""
        return self._train if self._eval is None else (self._train, self._eval)

    def get_train_env(self, lifelong: bool = False) -> "PersistentEnv":
        """Return a new train env, done every H_T steps; with `lifelong` its goal changes on a schedule."""
        task = self._train_task
        if not lifelong:
            return PersistentEnv(task, task.train_horizon)
        protocol = self._lifelong.protocol(task)
        return PersistentEnv(task, protocol.train_horizon, protocol.goal_change)

    def get_eval_env(self) -> "PersistentEnv":
        """Return a new eval env, done every H_E steps."""
        return PersistentEnv(self._task, self._task.eval_horizon)

    def has_demos(self) -> bool:
        """Return whether the task has demonstrations."""
        return self._task.demonstrations.recorded

    def get_initial_states(self, num_samples: int | None = None) -> np.ndarray:
        """Return representative initial states [I, s], at most `num_samples` (the original ignores the number)."""
        return np.array(self._task.initial_states[: num_samples or self._samples])

    def get_goal_states(self) -> np.ndarray:
        """Return the task goals [G, g] (the original returns None for the Minitaur)."""
        return np.array(self._task.goal_states)

    def get_demonstrations(self) -> tuple[Demonstrations, Demonstrations]:
        """Return forward and backward demonstrations.

        Each has float32 `observations [T, s + g]`, `actions [T, a]`, `rewards [T, 1]`, `next_observations [T, s + g]`
        and bool `terminals [T, 1]`, true on the last transition of each demonstration. They come from the tasks'
        scripts, not from the original's recordings; `demo_file` gives others (`earl-jax import-demos`).

        Raises:
            ValueError: the task has none (the original prints a line and returns None).
        """
        return self._demonstrations("forward"), self._demonstrations("backward")

    def _demonstrations(self, direction: str) -> Demonstrations:
        demos = self._task.demonstrations.load(direction)
        return {
            "observations": np.concatenate([demos.states, demos.goals], axis=1),
            "actions": np.array(demos.actions),
            "rewards": np.array(demos.rewards)[:, None],
            "terminals": np.array(demos.ends)[:, None],
            "next_observations": np.concatenate([demos.next_states, demos.goals], axis=1),
        }


class PersistentEnv:
    """An environment that keeps its state until the caller resets it, with the four-tuple `step` of old gym.

    `done` is true after `horizon` steps to report that a reset is due, and has no other effect, as in the original.
    Differences: spaces are gymnasium's. `done` is true as well when the simulation breaks, and the state is the one
    before that step. `info` is `{"success": bool}` for every task. `compute_reward` returns a number for every task
    (for Sawyer the original returns a list, whose first entry it is).
    """

    def __init__(self, task: Env, horizon: int, goal_change: int = 0):
        """Make the env of `task`: done every `horizon` steps, a new goal every `goal_change` steps (0: never)."""
        task = dataclasses.replace(task, eval_horizon=horizon or LARGEST_INT)
        self._env = ResetFreeEnv(task, mode="eval", render_mode="rgb_array")
        self._goal_change = goal_change
        self._steps_since_change = 0
        self._seed: int | None = int(np.random.randint(2**31))
        self._reward = jax.jit(task.reward)
        self._success = jax.jit(task.success)
        self.observation_space = self._env.observation_space
        self.action_space = self._env.action_space
        self.metadata = self._env.metadata
        self.spec = None
        self.reward_range = (-np.inf, np.inf)
        self.num_interventions = 0
        self.total_steps = 0
        self.lifelong_return = 0.0

    def reset(self) -> np.ndarray:
        """Return the first observation [s + g] after an intervention, which is counted: s0 ~ rho and a task goal."""
        obs, _ = self._env.reset(seed=self._seed)
        self._seed = None
        self._steps_since_change = 0
        self.num_interventions += 1
        return obs

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict]:
        """Return observation [s + g], reward, done and info after one control step with `action [a]`.

        Raises:
            ValueError: the action has another shape or is not finite.
        """
        obs, reward, terminated, truncated, info = self._env.step(action)
        self.total_steps += 1
        self.lifelong_return += reward
        self._steps_since_change += 1
        if self._steps_since_change == self._goal_change:
            self._steps_since_change = 0
            obs = self.reset_goal()
        return obs, reward, terminated or truncated, {"success": info["success"]}

    def reset_goal(self, goal: np.ndarray | None = None) -> np.ndarray:
        """Return the observation [s + g] with `goal [g]`, or a random task goal (the original returns None)."""
        return self._env.set_goal(goal)

    @property
    def goal(self) -> np.ndarray:
        """The current goal [g]."""
        return np.array(self._env.state.env_state.info["goal"])

    def is_successful(self, obs: np.ndarray | None = None) -> Any:
        """Return whether `obs [..., s + g]`, or the current state, has reached its goal: bool, or bool [...]."""
        return self._evaluate(self._success, obs)

    def compute_reward(self, obs: np.ndarray | None = None) -> Any:
        """Return the reward of arriving in `obs [..., s + g]`, or in the current state: a number, or [...]."""
        return self._evaluate(self._reward, obs)

    def _evaluate(self, function: Callable, obs: np.ndarray | None) -> Any:
        current = self._env.state.env_state.obs if obs is None else obs
        value = np.array(function(np.asarray(current, np.float32)))
        return value if value.ndim else value.item()

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the next reset with `seed`, or from numpy's global generator; return the seed in a list."""
        self._seed = int(np.random.randint(2**31)) if seed is None else seed
        return [self._seed]

    def render(self, mode: str = "rgb_array") -> np.ndarray | None:
        """Return a picture [480, 640, 3], uint8.

        Raises:
            ValueError: the `mode` is another one; there is no window.
        """
        if mode != "rgb_array":
            raise InputError(f"render mode {mode!r} is not supported; use rgb_array")
        return self._env.render()

    def close(self) -> None:
        """Release the resources of the pictures."""
        self._env.close()

    @property
    def unwrapped(self) -> "PersistentEnv":
        """This env, which wraps none."""
        return self


def _task_options(name: str, reward_type: str | None, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of the task `name`, translated from those of the original."""
    options = dict(options)
    kitchen_task = options.pop("kitchen_task", "all_pairs")
    if kitchen_task != "all_pairs":
        raise InputError(f"kitchen_task {kitchen_task!r} is not supported; use all_pairs, the benchmark's")
    if options.pop("wide_init_distr", False) and name == "tabletop_organization":
        options["wide"] = True
    return options if reward_type is None else {**options, "reward_type": reward_type}
