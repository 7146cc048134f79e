"""Demonstrations by scripted experts: how the files in assets/demos come about, and come about again.

They imitate the pace of the originals (tabletop: half speed, one axis after the other; all with some noise), because shorter
demonstrations would make every method's task easier than the published one. The DHand has none in the paper and none ship;
those that are made here are for whoever wants to give a learner some (`--set demo_file=...`).
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.assets import DIRECTIONS, Demos
from earl_jax.envs.base import Env, State
from earl_jax.envs.dhand import DHandLightbulb
from earl_jax.envs.sawyer.door import SawyerDoor
from earl_jax.envs.sawyer.peg import SawyerPeg
from earl_jax.envs.tabletop import STEP, TabletopOrganization

PACE = 0.5
NOISE = {TabletopOrganization: 0.1, SawyerDoor: 0.2, SawyerPeg: 0.2, DHandLightbulb: 0.1}
"""Half-width of the uniform noise on all actions but the last, and which tasks have a demonstrator."""
GRASPS, HOLD = 20, 200
"""Demonstrations of the DHand, and the steps of each: it lifts the bulb and goes on holding it."""
AXIS_DONE = 0.05
PER_GOAL = 3
DOORS, PEGS = 5, 10
"""Demonstrations a direction, as in the paper's table."""
LONGEST = 400


def tabletop_action(env: TabletopOrganization, obs: np.ndarray) -> np.ndarray:
    """Return the demonstrator's action [3]: the expert's waypoint at half speed, x before y."""
    target, grip = env.waypoint(jnp.asarray(obs), tolerance=0.1)
    offset = np.asarray(target) - obs[:2]
    along = 0 if abs(offset[0]) > AXIS_DONE else 1
    move = np.zeros(2)
    move[along] = np.clip(offset[along] / STEP, -PACE, PACE)
    return np.append(move, grip)


def record(env: Env, state: State, rng: np.random.Generator, steps: int | None = None) -> tuple[list[tuple], State]:
    """Return the transitions of one demonstration from `state` and the state it ended in: until success, or `steps` of them.

    Raises:
        RuntimeError: the demonstrator did not reach its goal within 400 steps, or does not stand in it after `steps`.
    """
    step, expert, rows, size = jax.jit(env.step), jax.jit(env.expert), [], env.state_size
    for number in range(steps or LONGEST):
        obs = np.asarray(state.obs)
        action = np.array(tabletop_action(env, obs) if isinstance(env, TabletopOrganization) else expert(state.obs))
        action[:-1] += rng.uniform(-NOISE[type(env)], NOISE[type(env)], len(action) - 1)
        action = np.clip(action, -1.0, 1.0).astype(np.float32)
        state = step(state, action)
        after, reached = np.asarray(state.obs), bool(env.success(state.obs))
        ends = reached if steps is None else number + 1 == steps
        rows.append((obs[:size], obs[size:], action, after[:size], np.float32(reached), ends))
        if reached and ends:
            return rows, state
    raise RuntimeError(f"the scripted expert of {env.name} missed {np.asarray(state.info['goal'])}")


def _starts(env: Env, seed: int) -> Iterator[tuple[State, State | None, np.ndarray]]:
    """Yield a forward start, a backward one (None: where the forward demonstration ends) and the backward goal."""
    if isinstance(env, TabletopOrganization):
        for goal in np.repeat(env.goal_states, PER_GOAL, axis=0):
            yield env.with_goal(env.reset(jax.random.key(seed)), jnp.asarray(goal)), None, env.initial_states[0]
        return
    count = PEGS if isinstance(env, SawyerPeg) else DOORS
    for number in range(count):
        key = jax.random.fold_in(jax.random.key(seed), number)
        inserted = dataclasses.replace(env, reset_at_goal=True).reset(key) if isinstance(env, SawyerPeg) else None
        yield env.reset(key), inserted, env.initial_states[number % len(env.initial_states)]


def make(env: Env, seed: int = 0) -> dict[str, Demos]:
    """Return forward and backward demonstrations: three a goal (tabletop), five (door) or ten (peg) of each; 20 forward (DHand).

    Backward ones start where their forward one ended; the peg's start inserted with the hand at home, as published.

    Raises:
        ValueError: the task has no demonstrator.
    """
    if type(env) not in NOISE:
        raise ValueError(f"{env.name} has no demonstrator; choose from {', '.join(task.name for task in NOISE)}")
    rng = np.random.default_rng(seed)
    if isinstance(env, DHandLightbulb):
        keys = jax.random.split(jax.random.key(seed), GRASPS)
        return {"forward": stacked([row for key in keys for row in record(env, env.reset(key), rng, HOLD)[0]])}
    found: dict[str, list[tuple]] = {direction: [] for direction in DIRECTIONS}
    for forward, backward, goal in _starts(env, seed):
        rows, ended = record(env, forward, rng)
        found["forward"] += rows
        start = ended if backward is None else backward
        rows, _ = record(env, env.with_goal(start, jnp.asarray(goal)), rng)
        found["backward"] += rows
    return {name: stacked(rows) for name, rows in found.items()}


def stacked(rows: list[tuple]) -> Demos:
    """Return the transitions of `record` as arrays."""
    return Demos(*[np.stack(field) for field in zip(*rows, strict=True)])


def save(demos: dict[str, Demos], path: Path) -> None:
    """Write both directions to `path` as a compressed npz without pickles."""
    arrays = {f"{name}_{field}": value for name, part in demos.items() for field, value in part._asdict().items()}
    np.savez_compressed(path, **arrays)
