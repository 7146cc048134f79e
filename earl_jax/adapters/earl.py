"""The interface of the original benchmark: `from earl_jax.adapters import earl as earl_benchmark` is the one import to change.

Behaviour follows the released `EARLEnvs` and its wrappers (github.com/architsharma97/earl_benchmark). What differs is said
where it does; the tasks' own differences stand in docs/environments.md.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from earl_jax.adapters.gymnasium import LifeEnv
from earl_jax.envs import Env, make
from earl_jax.protocol import Continuing

NAMES = {"tabletop_manipulation": "tabletop_organization", "kitchen": "franka_kitchen", "minitaur": "minitaur_pen"}
"""The original's names where they are others than ours, which are understood too."""
Demonstrations = dict[str, np.ndarray]


class EARLEnvs:
    """A train and an eval env of one task, with its goals, initial states and demonstrations.

    Where `reward_type` is left out it is the task's: sparse for tabletop, door and peg as there, dense for the others (there, the
    kitchen refuses `sparse`, which is the default, and the Minitaur ignores it). Randomness comes from numpy's global generator
    at construction, so that `np.random.seed` in a script does what it did.
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
            env_name: the original's (`tabletop_manipulation`, `sawyer_door`, `sawyer_peg`, `kitchen`, `minitaur`) or ours.
            reward_type: `sparse` or `dense`.
            reset_train_env_at_goal: start the train env at the goal; there tabletop can do so too, and others ignore it.
            setup_as_lifelong_learning: a train env alone, whose goal changes every `goal_change_frequency` steps.
            options: the original's `train_horizon`, `eval_horizon`, `num_initial_state_samples`, `goal_change_frequency`,
                `wide_init_distr` (which only tabletop heeds, as there) and `kitchen_task`, and the task's own, such as `physics`.

        Raises:
            ValueError: an unknown name or option (the original ignores those), or one that this task does not have.
        """
        self._samples = options.pop("num_initial_state_samples", None)
        self._change = options.pop("goal_change_frequency", None)
        name = NAMES.get(env_name, env_name)
        self._task = make(name, **_translated(name, reward_type, options))
        self._lifelong, self._at_goal = setup_as_lifelong_learning, reset_train_env_at_goal
        if self._at_goal and "reset_at_goal" not in _fields(self._task):
            raise ValueError(f"{self._task.name} has no start at its goal, sawyer_door and sawyer_peg have one")
        self._train = self.get_train_env(self._lifelong)
        self._eval = None if self._lifelong else self.get_eval_env()

    def get_envs(self) -> "PersistentEnv | tuple[PersistentEnv, PersistentEnv]":
        """Return the train and the eval env, or for lifelong learning the train env alone."""
        return self._train if self._eval is None else (self._train, self._eval)

    def get_train_env(self, lifelong: bool = False) -> "PersistentEnv":
        """Return a new train env, done every H_T steps; with `lifelong` its goal changes on the clock."""
        task = dataclasses.replace(self._task, **{"reset_at_goal": True}) if self._at_goal else self._task
        if not lifelong:
            return PersistentEnv(task, task.train_horizon)
        rules = Continuing(goal_change=self._change).protocol(task)
        return PersistentEnv(task, rules.train_horizon, rules.goal_change)

    def get_eval_env(self) -> "PersistentEnv":
        """Return a new eval env, done every H_E steps."""
        return PersistentEnv(self._task, self._task.eval_horizon)

    def has_demos(self) -> bool:
        """Return whether there are demonstrations."""
        return self._task.has_demos

    def get_initial_states(self, num_samples: int | None = None) -> np.ndarray:
        """Return representative initial states [I, s], at most `num_samples` of them (there, the number changes nothing)."""
        return np.array(self._task.initial_states[: num_samples or self._samples])

    def get_goal_states(self) -> np.ndarray:
        """Return the task goals [G, g]; there, nothing for the Minitaur."""
        return np.array(self._task.goal_states)

    def get_demonstrations(self) -> tuple[Demonstrations, Demonstrations]:
        """Return forward and backward demonstrations: float32 `observations [T, s + g]`, `actions [T, a]`, `rewards [T, 1]`,
        `next_observations [T, s + g]` and bool `terminals [T, 1]`, true on the last transition of each.

        They are our own experts', not the original's recordings; `demo_file` gives others (`earl-jax import-demos`).

        Raises:
            ValueError: there are none (the original prints a line and returns None).
        """
        return self._demonstrations("forward"), self._demonstrations("backward")

    def _demonstrations(self, direction: str) -> Demonstrations:
        demos = self._task.demos(direction)
        return {
            "observations": np.concatenate([demos.states, demos.goals], axis=1),
            "actions": np.array(demos.actions),
            "rewards": np.array(demos.rewards)[:, None],
            "terminals": np.array(demos.ends)[:, None],
            "next_observations": np.concatenate([demos.next_states, demos.goals], axis=1),
        }


class PersistentEnv:
    """A world that stays as it is until somebody resets it, with the four-tuple `step` of old gym.

    `done` says after `horizon` steps that a reset is due, and does nothing by itself, as there. Differs from the original: spaces
    are gymnasium's; where the simulation breaks the env is done too, as it was one step before; `info` is `{"success": bool}` for
    every task; `compute_reward` gives a number for every task (Sawyer's a list there, whose first entry it is).
    """

    def __init__(self, task: Env, horizon: int, goal_change: int = 0):
        """Make the env of `task`, done every `horizon` steps, with another task goal every `goal_change` steps, 0 for never."""
        self._env = LifeEnv(dataclasses.replace(task, eval_horizon=horizon), mode="eval", render_mode="rgb_array")
        self._goal_change, self._steps_since_change = goal_change, 0
        self._seed: int | None = int(np.random.randint(2**31))
        self._reward, self._success = jax.jit(task.reward), jax.jit(task.success)
        self.observation_space, self.action_space = self._env.observation_space, self._env.action_space
        self.metadata, self.spec, self.reward_range = self._env.metadata, None, (-np.inf, np.inf)
        self.num_interventions, self.total_steps, self.lifelong_return = 0, 0, 0.0

    def reset(self) -> np.ndarray:
        """Return the first observation [s + g] after an intervention, which is counted: s0 ~ rho and a task goal."""
        obs, _ = self._env.reset(seed=self._seed)
        self._seed, self._steps_since_change = None, 0
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
        """Return the observation [s + g] under `goal [g]`, or a task goal drawn uniformly (there, nothing is returned)."""
        return self._env.set_goal(goal)

    @property
    def goal(self) -> np.ndarray:
        """The goal [g] that is commanded now."""
        return np.array(self._env.life.world.info["goal"])

    def is_successful(self, obs: np.ndarray | None = None) -> Any:
        """Return whether `obs [..., s + g]`, or the world as it is, has reached its goal: bool, or bool [...] for a batch."""
        return self._asked(self._success, obs)

    def compute_reward(self, obs: np.ndarray | None = None) -> Any:
        """Return the reward of arriving in `obs [..., s + g]`, from these numbers alone: a number, or [...] for a batch."""
        return self._asked(self._reward, obs)

    def _asked(self, question: Callable, obs: np.ndarray | None) -> Any:
        answer = np.array(question(np.asarray(self._env.life.world.obs if obs is None else obs, np.float32)))
        return answer if answer.ndim else answer.item()

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Make the next reset begin with `seed`, or with numpy's global generator without one; return it in a list."""
        self._seed = int(np.random.randint(2**31)) if seed is None else seed
        return [self._seed]

    def render(self, mode: str = "rgb_array") -> np.ndarray | None:
        """Return a picture [480, 640, 3], uint8; there is no window.

        Raises:
            ValueError: another `mode`.
        """
        if mode != "rgb_array":
            raise ValueError(f"render mode {mode!r} is not rgb_array, the only one there is")
        return self._env.render()

    def close(self) -> None:
        """Give back what pictures took."""
        self._env.close()

    @property
    def unwrapped(self) -> "PersistentEnv":
        """This env: nothing is wrapped."""
        return self


def _fields(task: Env) -> set[str]:
    return {field.name for field in dataclasses.fields(task)}


def _translated(name: str, reward_type: str | None, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of the task `name`, the original's by our names."""
    options = dict(options)
    kitchen = options.pop("kitchen_task", "all_pairs")
    if kitchen != "all_pairs":
        raise ValueError(f"kitchen_task {kitchen!r} is not all_pairs, the benchmark's, which is the only one here")
    if options.pop("wide_init_distr", False) and name == "tabletop_organization":
        options["wide"] = True
    return options if reward_type is None else {**options, "reward_type": reward_type}
