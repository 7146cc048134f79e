"""Demonstrations recorded from the script of a task: these functions made the files in assets/demos.

The scripts imitate the pace of the original demonstrations (tabletop: half speed, one axis after the other; all tasks:
some noise), because shorter demonstrations would make the task easier for every method than the published one.
"""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import envs
from earl_jax.assets import DIRECTIONS, Demos
from earl_jax.envs import Env, State
from earl_jax.envs.demonstrations import DemoScript
from earl_jax.errors import InputError
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import SEED, require

MAX_STEPS = 400
"""Steps after which a demonstration that is to end at success has failed."""


@package_types()
def make(env: Env, seed: int = 0) -> dict[str, Demos]:
    """Return the demonstrations of `env` by direction: one for each start that the task's script names.

    Raises:
        ValueError: the task has no demonstration script (the message lists the tasks that have one), or a demonstration
            failed, as in `record`.
    """
    script = _require_script(env)
    require("seed", seed, SEED)
    rng = np.random.default_rng(seed)
    rows: dict[str, list[tuple]] = {direction: [] for direction in DIRECTIONS}
    for start in script.starts(seed):
        forward, end = record(env, start.forward, rng, script.hold)
        rows["forward"] += forward
        if start.backward_goal is not None:
            state = end if start.backward is None else start.backward
            state = env.with_goal(state, jnp.asarray(start.backward_goal))
            rows["backward"] += record(env, state, rng, script.hold)[0]
    return {direction: stacked(recorded) for direction, recorded in rows.items() if recorded}


def _require_script(env: Env) -> DemoScript:
    """Return the task's demonstration script. Errors as `record`."""
    if env.demonstrations.script is None:
        scripted = [name for name in envs.list_envs() if envs.make(name).demonstrations.script]
        variant = " with these options" if env.name in scripted else ""
        raise InputError(f"{env.name} has no demonstration script{variant}; choose from {', '.join(scripted)}")
    return env.demonstrations.script


def record(env: Env, state: State, rng: np.random.Generator, steps: int | None = None) -> tuple[list[tuple], State]:
    """Return the transitions of one demonstration from `state` and its last state.

    It ends at success, or after `steps` steps if given. `rng` draws the noise on all action components except the last.

    Raises:
        ValueError: the task has no demonstration script (the message lists the tasks that have one), or the goal was
            not reached within 400 steps, or is not reached at the end of `steps` steps.
    """
    script, size = _require_script(env), env.state_size
    act, noise = script.action or functools.partial(_expert_action, env), script.noise
    rows = []
    for number in range(steps or MAX_STEPS):
        obs = np.asarray(state.obs)
        action = np.array(act(obs))
        action[:-1] += rng.uniform(-noise, noise, len(action) - 1)
        action = np.clip(action, -1.0, 1.0).astype(np.float32)
        state = _step(env, state, action)
        next_obs = np.asarray(state.obs)
        reached = bool(state.metrics["success"])
        ends = reached if steps is None else number + 1 == steps
        rows.append((obs[:size], obs[size:], action, next_obs[:size], np.float32(reached), ends))
        if reached and ends:
            return rows, state
    raise InputError(f"{env.name}: the script missed the goal {np.asarray(state.info['goal'])} in {len(rows)} steps")


_step = jax.jit(lambda env, state, action: env.step(state, action), static_argnums=0)


@functools.partial(jax.jit, static_argnums=0)
def _expert_action(env: Env, obs: jax.Array) -> jax.Array:
    expert = env.demonstrations.expert
    if expert is None:
        raise InputError(f"the demonstration script of {env.name} needs an action or an expert")
    return expert(obs)


def stacked(rows: list[tuple]) -> Demos:
    """Return the transitions of `record` as arrays."""
    return Demos(*[np.stack(field) for field in zip(*rows, strict=True)])


def save(demos: dict[str, Demos], path: Path) -> None:
    """Write `demos`, by direction, to `path` as a compressed npz without pickles; a failure keeps an older file."""
    arrays = {f"{name}_{field}": value for name, part in demos.items() for field, value in part._asdict().items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("wb") as file:  # NumPy would add .npz to another suffix
            np.savez_compressed(file, **arrays)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise OSError(f"{path} can't be written: {error.strerror or error}") from error
