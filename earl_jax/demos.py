"""Demonstrations by scripted experts: how the files in assets/demos come about, and come about again.

They imitate the pace of the originals (half speed with some noise, one axis after the other on tabletop), because shorter
demonstrations would make every method's task easier than the published one.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.assets import DIRECTIONS, Demos
from earl_jax.envs.base import Env, State
from earl_jax.envs.tabletop import STEP, TabletopOrganization

PACE = 0.5
NOISE = 0.1
AXIS_DONE = 0.05
PER_GOAL = 3
LONGEST = 400


def tabletop_action(env: TabletopOrganization, obs: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the demonstrator's action [3]: the expert's waypoint at half speed, x before y, with noise of 0.1 an axis."""
    target, grip = env.waypoint(jnp.asarray(obs), tolerance=0.1)
    offset = np.asarray(target) - obs[:2]
    along = 0 if abs(offset[0]) > AXIS_DONE else 1
    move = np.zeros(2)
    move[along] = np.clip(offset[along] / STEP, -PACE, PACE)
    return np.append(move + rng.uniform(-NOISE, NOISE, 2), grip).astype(np.float32)


def record(env: TabletopOrganization, state: State, rng: np.random.Generator) -> tuple[list[tuple], State]:
    """Return the transitions of one demonstration from `state` until success, and the state it ended in.

    Raises:
        RuntimeError: the demonstrator did not reach its goal within 400 steps.
    """
    step, rows, size = jax.jit(env.step), [], env.state_size
    for _ in range(LONGEST):
        obs = np.asarray(state.obs)
        action = tabletop_action(env, obs, rng)
        state = step(state, action)
        after, reached = np.asarray(state.obs), bool(env.success(state.obs))
        rows.append((obs[:size], obs[size:], action, after[:size], np.float32(reached), reached))
        if reached:
            return rows, state
    raise RuntimeError(f"the scripted expert of {env.name} missed {np.asarray(state.info['goal'])}")


def make(env: Env, seed: int = 0) -> dict[str, Demos]:
    """Return forward and backward demonstrations, three a task goal, each backward one from where its forward one ended.

    Raises:
        ValueError: the task has no demonstrator.
    """
    if not isinstance(env, TabletopOrganization):
        raise ValueError(f"{env.name} has no demonstrator; choose from {TabletopOrganization.name}")
    rng = np.random.default_rng(seed)
    found: dict[str, list[tuple]] = {direction: [] for direction in DIRECTIONS}
    for goal in np.repeat(env.goal_states, PER_GOAL, axis=0):
        state = env.with_goal(env.reset(jax.random.key(seed)), jnp.asarray(goal))
        rows, state = record(env, state, rng)
        found["forward"] += rows
        rows, _ = record(env, env.with_goal(state, jnp.asarray(env.initial_states[0])), rng)
        found["backward"] += rows
    return {name: Demos(*[np.stack(field) for field in zip(*rows, strict=True)]) for name, rows in found.items()}


def save(demos: dict[str, Demos], path: Path) -> None:
    """Write both directions to `path` as a compressed npz without pickles."""
    arrays = {f"{name}_{field}": value for name, part in demos.items() for field, value in part._asdict().items()}
    np.savez_compressed(path, **arrays)
