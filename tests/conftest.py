"""Shared fixtures and helpers: one tiny problem, so that its programs compile once for the whole suite."""

import contextlib
import fcntl
import functools
import gc
import os
import platform
import shutil
import sys
from importlib import metadata
from pathlib import Path
from unittest.mock import Mock

os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Compilation takes most of the tests' time. At level 0 several programs compute NaN with the instructions of AVX2, so AVX is
# the last set. An unknown flag ends the process, so only releases that are known to have them get them.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0 --xla_cpu_max_isa=AVX --xla_cpu_parallel_codegen_split_count=1"
    " --xla_disable_hlo_passes=while-loop-invariant-code-motion,while-loop-constant-sinking"
    + " --xla_cpu_use_fusion_emitters=false"
    * metadata.version("jaxlib").startswith("0.10.")
    if metadata.version("jaxlib").startswith(("0.10.", "0.12.")) and platform.machine().lower() in ("x86_64", "amd64")
    else "",
)

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.algos import list_algos, make_algo
from earl_jax.algos.learner.replay import unpack
from earl_jax.envs import make
from earl_jax.metrics.phase_stats import BACK, FORWARD
from earl_jax.options import imports, registry
from earl_jax.options.schedule import Schedule
from earl_jax.protocol import Deployment, Protocol, Rules
from earl_jax.runs.config import RunConfig
from earl_jax.runs.policies import save_policies
from earl_jax.training import api, runner, select_seed, train
from earl_jax.training.plan import per_lane
from earl_jax.training.policy import actor_of_arrays
from earl_jax.training.scan import run_steps
from earl_jax.training.state import Problem, seed_keys

pytest.register_assert_rewrite("tests.cli.process")
TESTS = Path(__file__).parent
CACHE = TESTS.parent / ".cache" / "jax"
TINY = {"hidden_sizes": [16], "batch_size": 16, "random_steps": 20}
RUN_STEPS = 120
"""The length of the tiny runs, which is part of the shapes of their programs: one length, one program a method."""
TINY_RUN = {"seeds": 2, "steps": RUN_STEPS, "eval_every": 40, "eval_episodes": 2}
CHUNK = 20
"""Steps of the programs that tests share; VaPRL refreshes as often."""
ALGOS = ["fbrl", "naive", "oracle", "r3l", "vaprl"]
"""The methods of the paper."""


MINE = """
import dataclasses
import earl_jax
from earl_jax.algos.naive import Naive
from earl_jax.envs.tabletop import TabletopOrganization
from beside_mine import GRASS

@dataclasses.dataclass(frozen=True)
class Meadow(TabletopOrganization):
    grass: float = GRASS
    name = "meadow"

class Patient(Naive):
    name = "patient"

class Slow(earl_jax.SAC):
    name = "slow"

earl_jax.register_env("meadow", Meadow)
earl_jax.register_algo("patient", Patient)
earl_jax.register_learner("slow", Slow)
"""
"""A file of a user with a task, a method and a learner, whose programs are those of naive RL on tabletop."""


def pytest_configure(config):
    search = functools.cache(lambda path, entry_points=metadata.entry_points, **group: entry_points(**group))
    metadata.entry_points = lambda **group: search(tuple(sys.path), **group)  # it reads the metadata of every package
    gc.freeze()
    gc.set_threshold(100_000, 50, 50)  # tracing makes many objects: collections took a third of its time
    jax.config.update("jax_compilation_cache_dir", str(CACHE))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)  # also for the other workers


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Let one worker after another import the tests: in a fresh clone the first one writes the bytecode for all."""
    CACHE.parent.mkdir(exist_ok=True)
    with (CACHE.parent / "collection.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return (yield)


@contextlib.contextmanager
def own_registries():
    """A context after which what was registered and imported in it is unknown again, as in another process."""
    with pytest.MonkeyPatch.context() as patch:
        for table in (registry.ENVS, registry.ALGOS, registry.LEARNERS):
            patch.setattr(table, "_table", dict(table._table))
        patch.setattr(imports, "_noted", {})
        patch.setattr(sys, "path", list(sys.path))
        yield
        for path in imports._noted:
            sys.modules.pop(path.stem, None)


@pytest.fixture
def registries():
    with own_registries():
        yield


@pytest.fixture
def no_training(monkeypatch):
    """Let a command that starts to train fail instead."""
    monkeypatch.setattr(api.Program, "run", Mock(side_effect=AssertionError("training started")))


@pytest.fixture(scope="session")
def env():
    return make("tabletop_organization")


@pytest.fixture(scope="session")
def problem(env):
    return make_problem(env, eval_every=40, eval_episodes=2)


@pytest.fixture(scope="session")
def door():
    return make_problem(make("sawyer_door", engine="c"), eval_every=40, eval_episodes=2)


@pytest.fixture(scope="session")
def graphics(env):
    """Skip tests that draw on a machine that cannot."""
    from earl_jax.rendering.scenes import Scene

    try:
        Scene(env, (8, 8)).close()
    except ValueError as error:
        pytest.skip(str(error))


def make_problem(env, **protocol):
    """Return the problem of `env` with its own horizons and the other fields of its `protocol`."""
    return Problem(env, Protocol(env.train_horizon, env.eval_horizon, **protocol))


def own_algos():
    """Return the names of the methods of this package, without those of packages that are installed beside it."""
    return [name for name in list_algos() if registry.ALGOS.locate(name)[1] == "earl_jax"]


def tiny_options(algo, **options):
    refresh = {"refresh_every": 20, "value_samples": 1} if algo == "vaprl" else {}
    return {**TINY, **refresh, **options}


def tiny_method(algo, lanes=2, **options):
    return per_lane(make_algo(algo, **tiny_options(algo, **options)), lanes)


def tiny_train(algo="fbrl", env="tabletop_organization", **options):
    """Return the result of a short run of the method named `algo`."""
    return train(env, algo, **{**TINY_RUN, **tiny_options(algo), **options})


@pytest.fixture
def whole_run(tmp_path):
    """Return the folder of R3L's run on tabletop of the published length, with the policies that ship for its five seeds."""
    kept = TESTS.parent / "benchmarks" / "results" / "paper" / "tabletop_organization" / "r3l" / "replay_capacity_None"
    folder = shutil.copytree(kept, tmp_path / "r3l")
    _, shipped = assets.pretrained("tabletop_organization", "r3l")
    arrays = {name: array[[0, 1, 0, 1, 0]] for name, array in shipped.items()}
    save_policies(folder / "policies.npz", actor_of_arrays(arrays), 2_500_000, range(5), obs_size=12, action_size=3)
    return folder


def make_config(env, method, seeds=(0, 1), setting=None, **lengths):
    """Return the config of a run of objects with the lengths of a tiny run and checkpoints as often, or other `lengths`."""
    schedule = Schedule(**{"steps": RUN_STEPS, "eval_every": 40, "eval_episodes": 2, "checkpoint_every": 40, **lengths})
    return RunConfig.from_objects(env, method, setting or Deployment(), seeds, schedule)


def make_train_state(problem, method, seeds, steps=RUN_STEPS, rules=None):
    """Return the lanes of `seeds` at step 0, with a replay that holds `steps` steps."""
    if rules is None:
        rules = jax.tree.map(lambda rule: jnp.full(len(seeds), rule), problem.protocol.rules)
    return runner._init(problem, method, seed_keys(seeds), rules, steps, None)


def lane_rules(horizon, chance, goal_change):
    """Return the rules of lanes from lists of their numbers."""
    return Rules(jnp.array(horizon), jnp.array(chance, jnp.float32), jnp.array(goal_change))


def stored_flags(state, steps):
    """Return the flags [steps, N] of the last `steps` transitions."""
    first = int(state.replay.row) - steps
    return jax.tree.map(np.asarray, unpack(state.replay.flags[first : first + steps]))


def advance(problem, method, state, steps, warmup=False):
    """Return the train state `steps` steps later, by the programs of `train`: whole chunks of `CHUNK` steps share one.

    They are shared by all tests, so a test that patches the code of a step takes `run_whole`.
    """
    lengths = [CHUNK] * (steps // CHUNK) + [steps % CHUNK] * (steps % CHUNK > 0)
    for length in lengths:
        state = runner._advance(problem, method, copy_of(state), length, warmup, None)
    return state


@jax.jit
def copy_of(tree):
    """Return a copy, by one program for all leaves, because `advance` gives its argument away."""
    return jax.tree.map(jnp.copy, tree)


def evaluate(problem, method, state):
    """Return the state after both evaluations and their metrics [N], by the program of `train`."""
    return runner._evaluate(problem, method, copy_of(state), None)


def run_whole(problem, method, state, steps, warmup=False):
    """Return the train state `steps` steps later, computed by one program of its own."""
    return jax.jit(lambda m, s: run_steps(problem, m, s, steps, warmup))(method, state)


def take_lane(tree, lane):
    """Return `lane`, an index or a slice, of a tree of arrays with a leading lane axis."""
    if isinstance(lane, int):
        return select_seed(tree, lane)
    return jax.jit(lambda tree: jax.tree.map(lambda leaf: leaf[lane], tree))(tree)


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


def without_shares(metrics):
    """Return `metrics` without the shares of phases that reached their goal: they are nan where no phase has ended."""
    return {name: values for name, values in metrics.items() if name not in (FORWARD, BACK)}


def write_mine(folder):
    """Return the path of `MINE` in `folder`, with the file beside it that it imports."""
    write_files({"mine.py": MINE, "beside_mine.py": "GRASS = 0.25\n"}, folder)
    return folder / "mine.py"


def write_files(files, folder):
    """Write the texts of `files`, by their paths, below `folder`."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
