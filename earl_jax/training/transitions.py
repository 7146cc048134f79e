"""The transitions of a life, from the replay of its newest checkpoint, cut into the agent's attempts."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from earl_jax.algos.goals import goal_table
from earl_jax.algos.learner.replay import Replay, unpack
from earl_jax.assets import Demos
from earl_jax.envs import Env
from earl_jax.errors import InputError
from earl_jax.options.seeds import lane_of
from earl_jax.runs.checkpoint import restore
from earl_jax.runs.folder import RunFolder
from earl_jax.training.loading import shapes_of


def load_transitions(folder: str | Path, seed: int) -> tuple[Env, Demos, np.ndarray]:
    """Return the env of a run folder, the T transitions that `seed` lived, and which of them are terminal, bool [T].

    They are the transitions that the replay of the newest checkpoint still contains, in order, without demonstrations.
    `goals` are the goals that the policy pursued. `ends` cut the life into attempts: where a goal was reached or the
    life ended, which is terminal, and at time-outs, goal changes and interventions, which are not (EARL's learners
    treat these as terminal too). Where the environment was reset, the replay has no next state: such a step is left out
    unless it reached its goal, in which case its state is repeated as the next state.

    Raises:
        ValueError: `folder` is not a run folder, or has no such seed or no intact checkpoint, or no transition is left.
    """
    opened = RunFolder.open(folder)
    lane = lane_of(seed, opened.config.seeds, f"in {folder}")
    env, _, shapes = shapes_of(opened, opened.config.steps)
    state = restore(opened.checkpoints, shapes)
    if state is None:
        raise InputError(f"{folder} has no checkpoint, which holds the replay")
    transitions, terminal = attempts(env, state.replay, lane, int(state.step))
    if not len(terminal):
        raise InputError(
            f"{folder} has no transition of seed {seed}: its life ended before the steps that the replay has, or an "
            "intervention followed each of them"
        )
    return env, transitions, terminal


def attempts(env: Env, replay: Replay, lane: int, steps: int) -> tuple[Demos, np.ndarray]:
    """Return the transitions of a `lane` after `steps` steps, and which of them are terminal."""
    first, size = int(replay.first_row), replay.capacity - int(replay.first_row)
    count = min(steps, size - 1) if replay.evicts else steps
    rows = first + (int(replay.row) - first - count + np.arange(count)) % size
    goal, reached, timeout, reset, absorbed, _ = map(np.asarray, unpack(replay.flags[rows, lane]))
    before = steps > count and unpack(replay.flags[int(replay.row), lane]).absorbed  # the step that was evicted last
    had_ended = np.append(before, absorbed[:-1])
    goals, states = goal_table(env).table[goal], replay.state[rows, lane]
    following = np.where(reset[:, None], states, replay.state[np.asarray(replay.successor(jnp.asarray(rows))), lane])
    if env.sparse:
        obs = np.concatenate([following, goals], axis=1)
        rewards = np.where(reset, reached, env.reward(jnp.asarray(obs))).astype(np.float32)
    else:
        rewards = replay.reward[rows, lane]
    number = np.cumsum(reached | timeout | absorbed)
    attempt = np.append(0, number[:-1])
    kept = ~(reset & ~reached) & ~had_ended
    ends = np.diff(attempt[kept], append=np.inf) > 0
    fields = (states, goals, replay.action[rows, lane], following, rewards)
    return Demos._make([*(field[kept] for field in fields), ends]), (reached | absorbed)[kept]
