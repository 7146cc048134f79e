"""Shared fixtures: one tiny world, so that a program compiles once for the whole suite."""

import os
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Compiling is most of the suite's time; at this level of the code generator it is 40 % less, for programs that run for seconds.
# Level 0 is faster still, but some programs compute NaN then.
os.environ["XLA_FLAGS"] = f"--xla_backend_optimization_level=1 {os.environ.get('XLA_FLAGS', '')}"
# A third less again, for the versions that know this flag: an unknown one ends the process.
os.environ["XLA_FLAGS"] += " --xla_cpu_use_fusion_emitters=false" if version("jaxlib").startswith("0.10.") else ""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import make_algo
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.training import init as birth
from earl_jax.training import loop as autonomy
from earl_jax.training import per_lane
from earl_jax.training.state import Problem

CACHE = Path(__file__).parent.parent / ".cache" / "jax"
TINY = {"hidden_sizes": [16, 16], "batch_size": 16, "random_steps": 20}
SHIPPED = {"xla_cpu_use_fusion_emitters": True} if "fusion_emitters" in os.environ["XLA_FLAGS"] else {}
"""For a test of equal bits in two programs: the code generator that users have."""
LONGEST = [
    "test_reproduce.py", "test_physics.py", "test_sweep.py", "test_training.py", "test_autonomy.py", "test_devices.py",
    "test_cli.py", "test_dense_tasks.py", "test_packs.py", "test_sac.py", "test_gymnasium.py", "test_checkpoint.py",
]  # fmt: skip
ALGOS = ["fbrl", "naive", "oracle", "r3l", "vaprl"]


def pytest_configure(config):
    config.option.loadscopereorder = False  # pytest-xdist would start with the files of most tests
    jax.config.update("jax_compilation_cache_dir", str(CACHE))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def pytest_collection_modifyitems(items):
    """Put the longest files first, so that two workers end together."""
    names = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: names.get(item.path.name, len(names)))


@pytest.fixture(scope="session")
def env():
    return make("tabletop_organization")


@pytest.fixture(scope="session")
def problem(env):
    return Problem(env, Protocol(env.train_horizon, env.eval_horizon, eval_every=40, eval_episodes=2))


def tiny_options(algo, **options):
    refresh = {"refresh_every": 20, "value_samples": 1} if algo == "vaprl" else {}
    return {**TINY, **refresh, **options}


def tiny_method(algo, lanes=2, **options):
    return per_lane(make_algo(algo, **tiny_options(algo, **options)), lanes)


def newborn(problem, method, seeds, steps=200):
    keys = jax.vmap(jax.random.key)(jnp.asarray(seeds))
    capacity = birth.capacity_for(problem, method, steps)
    return jax.jit(lambda m, k: birth.begin(problem, m, k, capacity))(method, keys)


def advance(problem, method, lives, steps, explore=False, compiler=None):
    run = jax.jit(lambda m, state: autonomy.run(problem, m, state, steps, explore), compiler_options=compiler)
    return run(method, lives)


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
