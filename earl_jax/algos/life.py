"""What a life is made of: lanes, their tallies, the randomness of a step, and the world they are lived in."""

import dataclasses
from typing import Any, NamedTuple

import jax
from flax import struct

from earl_jax.algos import sac as sac_lib
from earl_jax.algos.method import Commands, Goals, goals_of
from earl_jax.algos.replay import Replay
from earl_jax.envs import Env, State
from earl_jax.protocol import Protocol, Rules

BINS = 64
"""Squares along a side of the map of visited places."""


class Tally(struct.PyTreeNode):
    """What a lane has earned and suffered: task reward since the last report and in all, interventions (`faults` among
    them were enforced by a broken simulation), goals reached."""

    window_reward: jax.Array
    total_reward: jax.Array
    interventions: jax.Array
    faults: jax.Array
    reached: jax.Array
    diagnostics: dict[str, jax.Array]


class Lane(struct.PyTreeNode):
    """One life: its key, world, phase, commands, learner, tally, and the rules it is lived by.

    `visits [BINS, BINS]`, int32, counts the places where it was, first axis x; None where the task has no map.
    """

    key: jax.Array
    world: State
    phase: jax.Array
    phase_step: jax.Array
    commands: Commands
    agent: sac_lib.Agent
    extra: Any
    tally: Tally
    rules: Rules
    visits: jax.Array | None


class Lives(struct.PyTreeNode):
    """All lanes (leading axis N), their replay, and the number of steps each has lived."""

    lanes: Lane
    replay: Replay
    step: jax.Array


class Keys(NamedTuple):
    """A lane's randomness of one step, a function of its seed and the step alone."""

    act: jax.Array
    goal: jax.Array
    reset: jax.Array
    sample: jax.Array
    relabel: jax.Array
    update: jax.Array


def keys_of(key: jax.Array, step: jax.Array) -> Keys:
    """Return the randomness of one lane at `step`."""
    parts = jax.random.split(jax.random.fold_in(key, step), len(Keys._fields))
    return Keys(*[parts[number] for number in range(len(Keys._fields))])


@dataclasses.dataclass(frozen=True)
class Loop:
    """The static half of a program: the world, its goals and the protocol it is lived under."""

    env: Env
    protocol: Protocol

    @property
    def goals(self) -> Goals:
        """The goal table that replay's indices point into."""
        return goals_of(self.env)
