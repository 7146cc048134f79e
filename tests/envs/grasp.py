"""Episodes of dhand_lightbulb without actions, with random ones, and with the scripted grasp."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.dhand.lightbulb import TARGET

POLICIES = ("zero", "random", "scripted")
OFFSETS = np.array([[0.0, 0.0], [0.04, 0.0], [-0.04, 0.0], [0.0, 0.04], [0.0, -0.04]], np.float32)
HEIGHT = slice(25, 26)
LIFTED = 0.1
HOLD = 50


def start_states(env: Any, count: int, seed: int) -> Any:
    """Return the states of the documented starts, then `count` of the task's own, stacked."""
    named = jax.jit(jax.vmap(env.start_at))(jnp.asarray(TARGET[:2] + OFFSETS))
    own = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(seed), count))
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), named, own)


def run_episodes(env: Any, state: Any, steps: int, seed: int) -> dict[str, np.ndarray]:
    """Return reward, success, height of the bulb and fault [steps, policies, starts], all lanes of all policies at once."""
    count = len(state.reward)
    lanes = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * len(POLICIES)), state)
    policy = jnp.repeat(jnp.arange(len(POLICIES)), count)[:, None]

    def step(state, key):
        noise = jax.random.uniform(key, (len(policy), env.action_size), minval=-1.0, maxval=1.0)
        scripted = jax.vmap(env.expert)(state.obs)
        action = jnp.where(policy == 0, 0.0, jnp.where(policy == 1, noise, scripted))
        state = jax.vmap(env.step)(state, action)
        return state, (
            state.reward,
            state.metrics["success"] > 0,
            state.obs[:, HEIGHT][:, 0],
            jax.vmap(env.fault)(state),
        )

    run = jax.jit(lambda lanes: jax.lax.scan(step, lanes, jax.random.split(jax.random.key(seed), steps))[1])
    curves = [np.asarray(leaf).reshape(steps, len(POLICIES), count) for leaf in run(lanes)]
    return dict(zip(("reward", "success", "height", "fault"), curves, strict=True))


def longest_run(success: np.ndarray) -> np.ndarray:
    """Return the largest number of consecutive successes [...] in `success [steps, ...]`."""
    best = run = np.zeros(success.shape[1:], int)
    for row in success:
        run = np.where(row, run + 1, 0)
        best = np.maximum(best, run)
    return best
