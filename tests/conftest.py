"""Shared fixtures and helpers: one tiny problem, so that its programs compile once for the whole suite."""

import functools
import os
from pathlib import Path

from tests.compiler import xla_flags

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ["XLA_FLAGS"] = xla_flags(os.environ.get("XLA_FLAGS", ""))

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import make_algo
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.training import train
from earl_jax.training.demo_rows import replay_capacity
from earl_jax.training.init import init_train_state
from earl_jax.training.loop import run_steps
from earl_jax.training.plan import per_lane
from earl_jax.training.state import Problem, seed_keys

TESTS = Path(__file__).parent
CACHE = TESTS.parent / ".cache" / "jax"
TINY = {"hidden_sizes": [16, 16], "batch_size": 16, "random_steps": 20}
TINY_RUN = {"seeds": 2, "steps": 120, "eval_every": 40, "eval_episodes": 2}
LONGEST = [
    "paper/test_reproduce.py", "physics/test_engines.py", "sweeps/test_launcher.py", "training/test_api.py",
    "training/test_loop.py", "training/test_devices.py", "cli/test_cli.py", "training/test_dense_tasks.py",
    "sweeps/test_worker.py", "algos/learner/test_sac.py", "adapters/test_gymnasium.py", "runs/test_checkpoint.py",
    "training/test_resume.py",
]  # fmt: skip
"""The files that take longest, relative to this folder."""
CHUNK = 20
"""Steps of the programs that tests share; VaPRL refreshes as often."""
ALGOS = ["fbrl", "naive", "oracle", "r3l", "vaprl"]


def pytest_configure(config):
    config.option.loadscopereorder = False  # pytest-xdist would start with the files of most tests
    jax.config.update("jax_compilation_cache_dir", str(CACHE))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def pytest_collection_modifyitems(items):
    """Put the longest files first, so that the workers end together."""
    ranks = {TESTS / name: rank for rank, name in enumerate(LONGEST)}
    items.sort(key=lambda item: ranks.get(item.path, len(ranks)))


@pytest.fixture(scope="session")
def env():
    return make("tabletop_organization")


@pytest.fixture(scope="session")
def problem(env):
    return make_problem(env, eval_every=40, eval_episodes=2)


def make_problem(env, **protocol):
    """Return the problem of `env` with its own horizons and the other fields of its `protocol`."""
    return Problem(env, Protocol(env.train_horizon, env.eval_horizon, **protocol))


def tiny_options(algo, **options):
    refresh = {"refresh_every": 20, "value_samples": 1} if algo == "vaprl" else {}
    return {**TINY, **refresh, **options}


def tiny_method(algo, lanes=2, **options):
    return per_lane(make_algo(algo, **tiny_options(algo, **options)), lanes)


def tiny_train(algo="fbrl", env="tabletop_organization", **options):
    """Return the result of a short run of the method named `algo`."""
    return train(env, algo, **{**TINY_RUN, **tiny_options(algo), **options})


@pytest.fixture(autouse=True)
def own_programs(request):
    """Give a test that patches code programs of its own: the shared ones would not contain the patch, or keep it."""
    patches = "monkeypatch" in request.fixturenames
    for shared in (_init_program, _steps_program) if patches else ():
        shared.cache_clear()
    yield
    for shared in (_init_program, _steps_program) if patches else ():
        shared.cache_clear()


def make_train_state(problem, method, seeds, steps=200, rules=None):
    """Return the lanes of `seeds` at step 0, with a replay that holds `steps` steps."""
    capacity = replay_capacity(problem, method, steps)
    return _init_program(problem, capacity)(method, seed_keys(seeds), rules)


@functools.cache
def _init_program(problem, capacity):
    return jax.jit(lambda method, keys, rules: init_train_state(problem, method, keys, capacity, rules))


def advance(problem, method, state, steps, explore=False, compiler_options=None):
    """Return the train state `steps` steps later. Whole chunks of `CHUNK` steps share one program."""
    lengths = [CHUNK] * (steps // CHUNK) + [steps % CHUNK] * (steps % CHUNK > 0)
    for length in lengths:
        state = run_whole(problem, method, state, length, explore, compiler_options)
    return state


def run_whole(problem, method, state, steps, explore=False, compiler_options=None):
    """Return the train state `steps` steps later, computed by one program."""
    options = tuple((compiler_options or {}).items())
    return _steps_program(problem, steps, explore, options)(method, state)


@functools.cache
def _steps_program(problem, steps, explore, options):
    run = functools.partial(run_steps, problem, steps=steps, explore=explore)
    return jax.jit(lambda method, state: run(method, state), compiler_options=dict(options))


def take_lane(tree, lane):
    """Return `lane`, an index or a slice, of a tree of arrays with a leading lane axis."""
    return jax.tree.map(lambda leaf: leaf[lane], tree)


def to_numpy(leaf):
    """Return an array as NumPy's; a PRNG key as its words."""
    is_key = jnp.issubdtype(jnp.asarray(leaf).dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


def assert_equal_trees(actual, expected, **tolerance):
    """Compare two trees, bit for bit unless a tolerance is given."""
    pairs = zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True)
    for actual_leaf, expected_leaf in pairs:
        if tolerance:
            np.testing.assert_allclose(to_numpy(actual_leaf), to_numpy(expected_leaf), **tolerance)
        else:
            np.testing.assert_array_equal(to_numpy(actual_leaf), to_numpy(expected_leaf))


def assert_all_finite(tree):
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(tree))


def write_files(files, folder):
    """Write the texts of `files`, by their paths, below `folder`."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
