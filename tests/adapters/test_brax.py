"""The brax adapter: its interface, brax's wrappers, and brax's own SAC on a jax that supports it."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.wrappers import training

from earl_jax.adapters.brax import wrap, wrap_for_training
from earl_jax.protocol import Deployment
from tests.adapters.test_gymnasium import TABLETOP, Fragile
from tests.conftest import assert_equal_trees

ROOT = Path(__file__).parents[2]
OLD = ROOT / ".cache" / "brax"
NEEDS = ["jax==0.9.2", "brax==0.14.2", "flax==0.12.6", "optax", "scipy", "mujoco==4.0.0", "mujoco-mjx==3.17.0"]
KEY = jax.random.PRNGKey(0)
MOVE = jnp.array([1.0, 0.0, -1.0])


def rollout(env, keys, steps, action=MOVE):
    """Return the last and all states of `steps` steps with one action after a reset, in one program."""

    def step(state, _):
        state = env.step(state, action)
        return state, state

    return jax.jit(lambda keys: jax.lax.scan(step, env.reset(keys), length=steps))(keys)


def test_raw_and_typed_keys_start_the_same_lifetime():
    env = wrap(TABLETOP)
    reset = jax.jit(env.reset)
    assert_equal_trees(reset(jax.random.PRNGKey(3)), reset(jax.random.key(3)))
    assert not np.array_equal(
        *(jax.random.key_data(reset(jax.random.PRNGKey(seed)).pipeline_state.key) for seed in (3, 4))
    )


def test_sizes_backend_and_interventions_of_a_lifetime():
    env = wrap(TABLETOP, train_horizon=4)
    assert (env.observation_size, env.action_size, env.backend) == (12, 3, "kinematic")
    _, states = rollout(env, KEY, 9)
    np.testing.assert_allclose(states.obs[:, 0], 0.2 * np.array([1, 2, 3, 0, 1, 2, 3, 0, 1]), atol=1e-6)
    np.testing.assert_array_equal(states.metrics["interventions"], [0, 0, 0, 1, 0, 0, 0, 1, 0])
    assert not states.done.any()


@pytest.mark.slow
def test_done_marks_a_fault_and_the_end_of_a_lifetime():
    fragile = wrap(Fragile(), mode="eval")
    _, states = rollout(fragile, KEY, 3)
    np.testing.assert_array_equal(states.done, [0, 0, 1])
    budget = wrap(TABLETOP, setting=Deployment(budget=2.0))
    _, states = rollout(budget, KEY, 3, jnp.array([0, 0, 0, 1.0]))
    np.testing.assert_array_equal(states.done, [0, 1, 1])


def test_braxs_wrappers_end_episodes_and_restore_state_and_goal():
    env = training.EvalWrapper(training.wrap(wrap(TABLETOP, mode="eval"), episode_length=5))
    state = jax.jit(env.reset)(jax.random.split(KEY, 3))
    first, step = state, jax.jit(env.step)
    goals = first.obs[:, 6:]
    for number in range(1, 11):
        state = step(state, jnp.tile(MOVE, (3, 1)))
        np.testing.assert_array_equal(state.done, number % 5 == 0)
        np.testing.assert_array_equal(state.pipeline_state.env_state.info["goal"], goals)
    np.testing.assert_array_equal(state.obs, first.obs)
    np.testing.assert_array_equal(state.info["truncation"], 1.0)
    assert set(state.info["eval_metrics"].episode_metrics) == {"reward", "success", "interventions"}


@pytest.mark.slow
def test_braxs_trainers_do_not_truncate_a_lifetime():
    for mode, done in (("train", 0.0), ("eval", 1.0)):
        env = wrap_for_training(wrap(TABLETOP, mode), episode_length=3)
        final, _ = rollout(env, jax.random.split(KEY), 3, jnp.tile(MOVE, (2, 1)))
        np.testing.assert_array_equal(final.done, done)


@pytest.fixture(scope="module")
def python():
    """A Python with a jax that brax's trainers support: $EARL_JAX_BRAX_PYTHON, or installed once from the index."""
    if "EARL_JAX_BRAX_PYTHON" in os.environ:
        return os.environ["EARL_JAX_BRAX_PYTHON"]
    path, stamp = OLD / "bin" / "python", OLD / "installed"
    if not stamp.is_file():
        subprocess.run([sys.executable, "-m", "venv", "--clear", str(OLD)], check=True)
        pip = [str(path), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        installation = subprocess.run([*pip, *NEEDS], capture_output=True, text=True)
        if installation.returncode:
            pytest.skip(f"no jax 0.9.2: set EARL_JAX_BRAX_PYTHON ({installation.stderr.strip().splitlines()[-1]})")
        stamp.touch()
    return str(path)


@pytest.mark.slow
def test_braxs_own_sac_learns_from_a_lifetime(python):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    environment = {name: value for name, value in environment.items() if name != "XLA_FLAGS"}
    script = str(ROOT / "tests" / "adapters" / "brax_trains.py")
    finished = subprocess.run([python, script], env=environment, capture_output=True, text=True, timeout=300)
    assert finished.returncode == 0, finished.stderr
    report = json.loads(finished.stdout.splitlines()[-1])
    before, after = report["rows"][0], report["rows"][-1]
    assert report["jax"].startswith("0.9.")
    assert after["step"] >= 4000
    assert all(math.isfinite(after[f"training/{name}_loss"]) for name in ("actor", "critic", "alpha"))
    assert after["eval/episode_reward"] > before["eval/episode_reward"] + 200
