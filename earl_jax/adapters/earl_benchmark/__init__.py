"""The interface of the original benchmark: `from earl_jax.adapters import earl_benchmark` replaces the original import.

Behaviour follows the released `EARLEnvs` (github.com/architsharma97/earl_benchmark), whose wrappers are in `wrappers`.
docs/adapters.md lists the differences of the interface, docs/tasks.md the differences of the tasks.
"""

import dataclasses
from typing import Any

import numpy as np

from earl_jax.adapters._session import make_task
from earl_jax.adapters.earl_benchmark.task_env import TaskEnv
from earl_jax.adapters.earl_benchmark.wrappers import Wrapper
from earl_jax.adapters.earl_benchmark.wrappers.lifelong_wrapper import LifelongWrapper
from earl_jax.adapters.earl_benchmark.wrappers.persistent_state_wrapper import PersistentStateWrapper
from earl_jax.errors import InputError
from earl_jax.options.values import COUNT, require
from earl_jax.protocol import Continuing, with_explicit_horizon

ORIGINAL_NAMES = {
    "tabletop_manipulation": "tabletop_organization",
    "kitchen": "franka_kitchen",
    "minitaur": "minitaur_pen",
}
"""Original names of tasks that are called otherwise in `earl_jax`; both names work."""
OWN_OPTIONS = (
    *("reset_train_env_at_goal", "setup_as_lifelong_learning", "num_initial_state_samples"),
    *("goal_change_frequency", "wide_init_distr", "kitchen_task"),
)
"""The options of `EARLEnvs` that its tasks do not have."""
Demonstrations = dict[str, np.ndarray]


class EARLEnvs:
    """A train and an eval env of one task, with its goals, initial states and demonstrations.

    The default `reward_type` is the task's own: sparse for tabletop, door and peg as in the original, dense for the
    others (in the original, the kitchen refuses the default `sparse`, and the Minitaur ignores it). Seeds are drawn
    from numpy's global generator at construction, so `np.random.seed` in a script works as before.
    """

    def __init__(
        self,
        env_name: str,
        reward_type: str | None = None,
        reset_train_env_at_goal: bool = False,
        setup_as_lifelong_learning: bool = False,
        *,
        num_initial_state_samples: int | None = None,
        goal_change_frequency: int | None = None,
        wide_init_distr: bool = False,
        kitchen_task: str = "all_pairs",
        **options: Any,
    ):
        """Make the envs.

        Args:
            env_name: a name of the original (`tabletop_manipulation`, `sawyer_door`, `sawyer_peg`, `kitchen`,
                `minitaur`) or of `list_envs()`.
            reward_type: `sparse` or `dense`.
            reset_train_env_at_goal: start the train env at the goal (door and peg only; in the original also tabletop,
                while its other tasks ignore the option).
            setup_as_lifelong_learning: make only a train env, whose goal changes every `goal_change_frequency` steps.
            num_initial_state_samples: largest number of states that `get_initial_states` returns; by default all.
            goal_change_frequency: steps between two goals in lifelong learning; by default the task's own number.
            wide_init_distr: the option `wide` of tabletop; other tasks ignore it, as in the original.
            kitchen_task: must be `all_pairs`, the task of the benchmark.
            options: options of the task: the original's `train_horizon` and `eval_horizon`, and others such as `engine`.

        Raises:
            ValueError: a name or an option is unknown (the original ignores unknown options), or this task lacks it.
        """
        self._samples = num_initial_state_samples
        continuing = Continuing(goal_change=goal_change_frequency)
        if kitchen_task != "all_pairs":
            raise InputError(f"kitchen_task {kitchen_task!r} is not supported; use all_pairs, the benchmark's")
        name = ORIGINAL_NAMES.get(env_name, env_name)
        if wide_init_distr and name == "tabletop_organization":
            options["wide"] = True
        if reward_type is not None:
            options["reward_type"] = reward_type
        self._task = self._train_task = make_task(name, options, OWN_OPTIONS)
        self._lifelong = with_explicit_horizon(continuing, self._task, options)
        if reset_train_env_at_goal:
            if not hasattr(self._task, "reset_at_goal"):
                raise InputError(f"{self._task.name} cannot start at its goal; sawyer_door and sawyer_peg can")
            self._train_task = dataclasses.replace(self._task, **{"reset_at_goal": True})
        self._train = self.get_train_env(setup_as_lifelong_learning)
        self._eval = None if setup_as_lifelong_learning else self.get_eval_env()

    def get_envs(self) -> Wrapper | tuple[Wrapper, Wrapper]:
        """Return the train and the eval env, or only the train env for lifelong learning."""
        return self._train if self._eval is None else (self._train, self._eval)

    def get_train_env(self, lifelong: bool = False) -> Wrapper:
        """Return a new train env, done every H_T steps; with `lifelong` its goal changes on a schedule."""
        env = TaskEnv(self._train_task)
        if not lifelong:
            return PersistentStateWrapper(env, self._train_task.train_horizon)
        protocol = self._lifelong.protocol(self._train_task)
        return LifelongWrapper(PersistentStateWrapper(env, protocol.train_horizon), protocol.goal_change)

    def get_eval_env(self) -> Wrapper:
        """Return a new eval env, done every H_E steps."""
        return PersistentStateWrapper(TaskEnv(self._task), self._task.eval_horizon)

    def has_demos(self) -> bool:
        """Return whether the task has demonstrations."""
        return self._task.demonstrations.recorded

    def get_initial_states(self, num_samples: int | None = None) -> np.ndarray:
        """Return representative initial states [I, g], at most `num_samples` (the original ignores the number)."""
        samples = self._samples if num_samples is None else num_samples
        if samples is not None:
            require("the number of samples", samples, COUNT)
        return np.array(self._task.initial_states[:samples])

    def get_goal_states(self) -> np.ndarray:
        """Return the task goals [G, g] (the original returns None for the Minitaur)."""
        return np.array(self._task.goal_states)

    def get_demonstrations(self) -> tuple[Demonstrations, Demonstrations]:
        """Return forward and backward demonstrations.

        Each has float32 `observations [T, s + g]`, `actions [T, a]`, `rewards [T, 1]`, `next_observations [T, s + g]`
        and bool `terminals [T, 1]`, true on the last transition of each demonstration. They come from the tasks'
        scripts, not from the original's recordings; the option `demo_file` replaces them (`earl-jax import-demos`). The
        rewards are sparse, as recorded, whatever the `reward_type` or `variant`, as in the original.

        Raises:
            ValueError: the task has no demonstrations (the original prints a line and returns None).
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
