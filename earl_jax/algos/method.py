"""What a method is: a few pure functions that the one loop of `autonomy` asks, with naive RL's answers as defaults."""

import functools
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from earl_jax import assets
from earl_jax.algos import sac as sac_lib
from earl_jax.algos.replay import GOAL_BITS, Rows
from earl_jax.algos.sac import SAC, Agent
from earl_jax.envs import Env

TASK, RETURN = 0, 1
"""The two phases of a life: reach the task goal, then do whatever the method does to be able to try again."""


class Goals(NamedTuple):
    """The static table of goals [M, g] of an env: `tasks` task goals, `initials` initial states, then demo states.

    Demo states stand in the order of the replay's first rows; `ends [C]` is the last state of each one's demonstration.
    `asked []` is the task goal that the world asks for, negative (or None) where a method may draw any.
    """

    table: np.ndarray
    tasks: int
    initials: int
    ends: np.ndarray
    asked: jax.Array | None = None

    @property
    def candidates(self) -> np.ndarray:
        """Demonstration states [C, g], the subgoals a curriculum chooses from."""
        return self.table[self.tasks + self.initials :]

    def draw_task(self, key: jax.Array) -> jax.Array:
        """Return the index of a task goal: the one that the world asks for, or uniform over all of them."""
        drawn = jax.random.randint(key, (), 0, self.tasks)
        return drawn if self.asked is None else jnp.where(self.asked >= 0, self.asked, drawn)


class Commands(NamedTuple):
    """Indices into the goal table: the `goal` that is commanded now and the `task` that the world rewards."""

    goal: jax.Array
    task: jax.Array


@functools.cache
def goals_of(env: Env) -> Goals:
    """Return the goal table of `env`; without demonstrations it holds task goals and initial states only."""
    parts, ends = [env.goal_states, env.initial_states], [np.zeros(0, int)]
    if env.has_demos and env.state_size == env.goal_size:
        for direction in env.demo_directions:
            states, last = trajectories(env.demos(direction))
            parts.append(states)
            ends.append(sum(map(len, ends)) + last)
    table = np.concatenate(parts).astype(np.float32)
    if len(table) > 1 << GOAL_BITS:
        raise ValueError(f"{env.name} has {len(table)} goals, replay packs at most {1 << GOAL_BITS}")
    return Goals(table, len(env.goal_states), len(env.initial_states), np.concatenate(ends))


def trajectories(demos: assets.Demos) -> tuple[np.ndarray, np.ndarray]:
    """Return every state [T + D, s] of D demonstrations in order, final ones included, and each one's last index."""
    pieces = np.split(np.arange(len(demos.ends)), np.flatnonzero(demos.ends)[:-1] + 1)
    states = [np.vstack([demos.states[piece], demos.next_states[piece[-1:]]]) for piece in pieces]
    lengths = np.array([len(part) for part in states])
    return np.concatenate(states), np.repeat(np.cumsum(lengths) - 1, lengths)


class Method(struct.PyTreeNode):
    """A way to live without resets. Subclasses override what differs; fields that are floats are vmappable leaves."""

    sac: SAC = SAC()

    name: ClassVar[str]
    controllers: ClassVar[int] = 1
    """Separate actor-critics, one a phase, each with its own share of the replay."""
    phases: ClassVar[int] = 1
    critics: ClassVar[int] = sac_lib.SOFT_CRITICS
    resets: ClassVar[bool] = False
    """Whether the end of a phase also resets the world: the oracle's privilege."""
    needs_demos: ClassVar[bool] = False
    demo_directions: ClassVar[tuple[str, ...]] = ("forward",)
    """Demonstrations put first in the replay; with two controllers, backward ones go to the second."""
    refresh_every: ClassVar[int] = 0
    """Steps between calls of `refresh`; 0 for never."""

    def demo_copies(self, steps_left: np.ndarray) -> np.ndarray:
        """Return how often [T] each demonstrated transition is listed, given the steps [T] to its demonstration's end."""
        return np.ones_like(steps_left)

    def phase_length(self, env: Env, phase: jax.Array) -> jax.Array | int:
        """Return the steps after which `phase` times out; H_E unless a method says otherwise."""
        del phase
        return env.eval_horizon

    def ends_on_success(self, phase: jax.Array) -> jax.Array | bool:
        """Return whether reaching the commanded goal ends `phase` (sparse tasks only)."""
        del phase
        return True

    def next_goal(self, key: jax.Array, goals: Goals, phase: jax.Array, lane: Commands, extra: Any) -> Commands:
        """Return the goals of the phase that begins: by default a fresh task goal, the current one included."""
        del phase, lane, extra
        task = goals.draw_task(key)
        return Commands(goal=task, task=task)

    def relabel(self, key: jax.Array, env: Env, goals: Goals, rows: Rows) -> Rows:
        """Return the sampled transitions of one lane, `rows [B]`, with the goals they are learnt under."""
        del key, env, goals
        return rows

    def reward(self, rows: Rows, phase: jax.Array, extra: Any) -> jax.Array:
        """Return the rewards [B] of sampled transitions; the task's by default."""
        del phase, extra
        return rows.reward

    def terminal(self, rows: Rows) -> jax.Array:
        """Return where [B] the target stops: at success, at the end of a life and, unless bootstrapped through, at time-outs."""
        return (
            rows.marks.reached
            | rows.marks.absorbed
            | (rows.marks.timeout & ~jnp.asarray(self.sac.timeout_bootstrap, bool))
        )

    def init_extra(self, key: jax.Array, env: Env, goals: Goals) -> Any:
        """Return what the method itself learns or remembers, a pytree; nothing by default."""
        del key, env, goals
        return ()

    def learn_extra(self, extra: Any, rows: Rows, phase: jax.Array) -> Any:
        """Return `extra` after a step on the batch that the active controller just learnt from."""
        del rows, phase
        return extra

    def refresh(self, key: jax.Array, env: Env, goals: Goals, agent: Agent, extra: Any) -> Any:
        """Return `extra` brought up to date with `agent` (leading controller axis) every `refresh_every` steps."""
        del key, env, goals, agent
        return extra
