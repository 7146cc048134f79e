"""Shared fixtures: one tiny world, so that a program compiles once for the whole suite."""

import os
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Compiling is most of the suite's time; at this level of the code generator it is 40 % less, for programs that run for seconds.
os.environ["XLA_FLAGS"] = f"--xla_backend_optimization_level=1 {os.environ.get('XLA_FLAGS', '')}"

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import autonomy, birth, make_algo
from earl_jax.algos.life import Loop
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.training import per_lane

CACHE = Path(__file__).parent.parent / ".cache" / "jax"
TINY = {"hidden_sizes": [16, 16], "batch_size": 16, "random_steps": 20}
LONGEST = {"test_physics.py", "test_sweep.py", "test_devices.py"}
ALGOS = ["fbrl", "naive", "oracle", "r3l", "vaprl"]


def pytest_configure():
    jax.config.update("jax_compilation_cache_dir", str(CACHE))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def pytest_collection_modifyitems(items):
    """Put the longest files first, so that two workers end together."""
    items.sort(key=lambda item: item.path.name not in LONGEST)


@pytest.fixture(scope="session")
def env():
    return make("tabletop_organization")


@pytest.fixture(scope="session")
def loop(env):
    return Loop(env, Protocol(env.train_horizon, env.eval_horizon, eval_every=40, eval_episodes=2))


def tiny_options(algo, **options):
    refresh = {"refresh_every": 20, "value_samples": 1} if algo == "vaprl" else {}
    return {**TINY, **refresh, **options}


def tiny_method(algo, lanes=2, **options):
    return per_lane(make_algo(algo, **tiny_options(algo, **options)), lanes)


def newborn(loop, method, seeds, steps=200):
    keys = jax.vmap(jax.random.key)(jnp.asarray(seeds))
    capacity = birth.capacity_for(loop, method, steps)
    return jax.jit(lambda m, k: birth.begin(loop, m, k, capacity))(method, keys)


def advance(loop, method, lives, steps, explore=False):
    return jax.jit(lambda m, state: autonomy.run(loop, m, state, steps, explore))(method, lives)


def plain(leaf):
    is_key = jnp.issubdtype(jnp.asarray(leaf).dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


def assert_same(one, other, **tolerance):
    """Equal trees, bit for bit unless a tolerance is given."""
    ones, others = jax.tree.leaves(one), jax.tree.leaves(other)
    assert len(ones) == len(others)
    for a, b in zip(ones, others, strict=True):
        if tolerance:
            np.testing.assert_allclose(plain(a), plain(b), **tolerance)
        else:
            np.testing.assert_array_equal(plain(a), plain(b))
