"""MJX inside the learner's scan: on a pendulum, and on a Sawyer task."""

import dataclasses
import functools
import json
import runpy

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import chosen_engine, make
from earl_jax.physics.engines import mjx
from tests.conftest import assert_all_finite, make_problem, make_train_state, run_whole, tiny_method, tiny_train
from tests.test_extending import PACKAGE

STEPS = 16


@pytest.fixture(scope="module")
def pendulum():
    """The MuJoCo task of examples/pasture, with one joint: the cheapest to compile on MJX."""
    module = runpy.run_path(str(PACKAGE / "earl_pasture" / "pendulum.py"))
    return module["PendulumHold"](engine="mjx", eval_horizon=6)


@functools.cache
def trained(env):
    """Return the first and the last state of two lanes after `STEPS` steps with updates, in one scan."""
    problem, method = make_problem(env), tiny_method("fbrl", random_steps=0)
    first = make_train_state(problem, method, [0, 1], STEPS)
    return first, run_whole(problem, method, first, STEPS)


@pytest.mark.parametrize("task", ["pendulum", pytest.param("sawyer_door", marks=pytest.mark.slow)])
def test_fbrl_learns_in_one_scan_with_mjx(pendulum, task):
    """The last state is finite, its actors have learnt, and every step was stored."""
    first, last = trained(pendulum if task == "pendulum" else make(task, engine="mjx"))
    assert_all_finite((last.replay, last.lanes.agent, last.lanes.counters))
    moved = jax.tree.map(lambda a, b: np.abs(a - b).max(), first.lanes.agent.actor, last.lanes.agent.actor)
    assert min(jax.tree.leaves(moved)) > 1e-5
    assert int(last.step) == STEPS
    assert np.asarray(last.lanes.counters.faults).tolist() == [0, 0]
    stored = np.asarray(last.replay.state[int(last.replay.row) - STEPS : int(last.replay.row)])
    assert np.abs(np.diff(stored, axis=0)).max(axis=(0, 2)).min() > 1e-3, "the simulation moves"


def test_a_step_on_mjx_calls_nothing_outside_the_program(pendulum):
    state = jax.eval_shape(pendulum.reset, jax.random.key(0))
    primitives = str(jax.make_jaxpr(pendulum.step)(state, jnp.zeros(1)))
    assert "callback" not in primitives
    assert "ffi_call" not in primitives


def test_training_agrees_with_the_engine_that_auto_takes_and_names_it(pendulum, tmp_path, capfd):
    options = {"steps": STEPS, "eval_every": STEPS, "random_steps": 0, "reward_scale": 10.0}
    result = tiny_train("fbrl", pendulum, engine="auto", progress=True, out=tmp_path / "run", **options)
    assert (chosen_engine(result.env), result.engine) == ("auto", "c")
    assert "physics engine: c, which auto takes for 2 lanes on this cpu machine\n" in capfd.readouterr().err
    assert json.loads((tmp_path / "run" / "config.json").read_text())["engine"] == "c"
    np.testing.assert_allclose(trained(pendulum)[1].replay.state, result.train_state.replay.state, atol=1e-3)


def test_python_traces_mjx_once_for_all_programs(pendulum, monkeypatch):
    traces, original = [], mjx.guard_kinematics
    monkeypatch.setattr(mjx, "guard_kinematics", lambda: traces.append(0) or original())
    env = dataclasses.replace(pendulum, substeps=3)  # a simulator that no other test has
    states = jax.eval_shape(jax.vmap(env.reset), jax.eval_shape(lambda: jax.random.split(jax.random.key(0), 2)))
    for step in (jax.vmap(env.step), jax.vmap(lambda state, action: env.step(env.step(state, action), action))):
        jax.eval_shape(step, states, jnp.zeros((2, 1)))
    assert len(traces) == 1
