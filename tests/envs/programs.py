"""Programs of tasks that several tests share: each is traced once in a process and compiled once in the suite."""

import functools
import operator

import jax
import jax.numpy as jnp
import numpy as np

START_COUNT = 500


@functools.cache
def program(env, method):
    """Return the method of `env` with that dotted name as one program; called eagerly, every operation would be one."""
    return jax.jit(operator.attrgetter(method)(env))


@functools.cache
def first_state(env):
    return program(env, "reset")(jax.random.key(0))


@functools.cache
def starts(env, method="reset", count=START_COUNT):
    """Return the states of `count` lanes after a reset, or another method that takes a key."""
    keys = jax.random.split(jax.random.key(0), count)
    return jax.jit(jax.vmap(operator.attrgetter(method)(env)))(keys)


@functools.partial(jax.jit, static_argnums=0)
def run_actions(env, states, actions):
    """Return the states [T, lanes, ...] after each of the `actions [T, lanes, a]`, from `states` of these lanes."""

    def step(states, action):
        states = jax.vmap(env.step)(states, action)
        return states, states

    return jax.lax.scan(step, states, actions)[1]


def run_alone(env, state, actions):
    """Return the states [T, ...] after each of the `actions [T, a]`, from `state` of one lane, as NumPy's arrays."""
    lane = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], state)
    states = run_actions(env, lane, np.float32(actions)[:, None])
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:, 0], states)
