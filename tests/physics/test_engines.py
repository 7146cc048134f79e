"""The three physics engines: they agree with each other, and `c` runs all lanes in one call."""

import dataclasses
import importlib.util
from unittest.mock import Mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.envs import make
from earl_jax.envs.minitaur.motors import MinitaurMotors
from earl_jax.physics.engines import c
from tests.envs.programs import first_state, program, starts

SAWYER = "sawyer_door", "sawyer_peg"
NEEDS_WARP = pytest.mark.skipif(importlib.util.find_spec("warp") is None, reason="earl-jax[warp] is not installed")
FREE_STEPS = 5
"""Control steps of a demonstration in which nothing touches the hand."""


def play(env, states, actions, observe):
    """Return what `observe` takes from the states [lanes, T, ...] of `env` under `actions [lanes, T, a]`."""

    def step(state, action):
        state = env.step(state, action)
        return state, observe(state)

    lanes = jax.vmap(lambda state, actions: jax.lax.scan(step, state, actions)[1])
    return np.asarray(jax.jit(lanes)(states, actions))


def observe_demonstrations(name, engine, steps):
    """Return the observed states [2, steps, 7] when `engine` plays the first two shipped demonstrations."""
    env, demos = make(name, engine=engine), assets.demos(name, "forward")
    firsts = np.append(0, np.flatnonzero(demos.ends) + 1)[:2]
    actions = np.stack([demos.actions[first : first + steps] for first in firsts])
    states = jax.jit(jax.vmap(env.demonstrations.state_at))(demos.states[firsts], demos.goals[firsts])
    return play(env, states, actions, lambda state: state.obs[:7])


NEEDS_ACCELERATOR = [pytest.mark.gpu, pytest.mark.skipif(jax.default_backend() == "cpu", reason="needs an accelerator")]
"""Marks of what shows that MJX computes in full float32 there."""


@pytest.mark.parametrize(
    ("engine", "name", "steps"),
    [
        ("mjx", "sawyer_door", 60),
        pytest.param("mjx", "sawyer_peg", 60, marks=pytest.mark.slow),
        *[pytest.param("mjx", name, 60, marks=NEEDS_ACCELERATOR) for name in SAWYER],
        *[pytest.param("warp", name, 20, marks=NEEDS_WARP) for name in SAWYER],
    ],
)
def test_engines_agree_tightly_before_contact_and_on_average_in_contact(engine, name, steps):
    actual, expected = (observe_demonstrations(name, each, steps) for each in (engine, "c"))
    hands = np.abs(actual[:, :FREE_STEPS, :3] - expected[:, :FREE_STEPS, :3])
    assert hands.max() < 5e-4, "metres: the weld of MuJoCo's C engine has had a term since 3.7 that MJX lacks"
    assert np.median(hands) < 5e-5
    assert 1e3 * np.linalg.norm(actual[..., 4:] - expected[..., 4:], axis=-1).mean() < 2.0, "millimetres"


TOLERANCES = {
    "cheetah_run": 5e-4, "dhand_lightbulb": 0.03, "fish_swim": 1e-4, "franka_kitchen": 5e-3, "minitaur_pen": 0.03
}  # fmt: skip
"""Tasks without demonstrations, and the largest difference [m, rad] of joints after `STEPS` control steps, contacts included."""
EARLY_STEPS, EARLY_TOLERANCE = 5, 1e-3
STEPS = 15


def joint_positions(name, engine):
    """Return joint positions [2, STEPS, nq] under slow sines, with a phase and a speed for each action."""
    env = make(name, engine=engine)
    time, number = np.arange(STEPS)[:, None], np.arange(env.action_size)
    actions = np.float32(0.8 * np.sin(0.2 * time * (1 + 0.2 * number) + number))
    return play(env, starts(env, count=2), np.stack([actions] * 2), lambda state: state.data.qpos)


@pytest.mark.parametrize(
    "engine", [pytest.param("mjx", marks=pytest.mark.slow), pytest.param("warp", marks=NEEDS_WARP)]
)
@pytest.mark.parametrize("name", TOLERANCES)
def test_engines_move_the_joints_of_the_other_tasks_alike(name, engine):
    actual, expected = joint_positions(name, engine), joint_positions(name, "c")
    assert np.ptp(expected, axis=1).max() > 0.05, "something moves"
    np.testing.assert_allclose(actual, expected, atol=TOLERANCES[name])
    np.testing.assert_allclose(actual[:, :EARLY_STEPS], expected[:, :EARLY_STEPS], atol=EARLY_TOLERANCE)


@pytest.mark.parametrize("name", SAWYER)
def test_c_makes_one_call_for_all_lanes_of_nested_vmaps(name, monkeypatch):
    env = make(name, engine="c")
    host = Mock(wraps=c.host_of(env.simulator, 0))
    monkeypatch.setattr(c, "host_of", lambda simulator, memory: host)
    states = jax.tree.map(lambda leaf: leaf.reshape(2, 3, *leaf.shape[1:]), starts(env, count=6))
    action = jnp.array([0.3, -0.2, 0.1, -1.0])
    nested = jax.jit(jax.vmap(jax.vmap(lambda s: env.step(s, action))))(states)
    nested.obs.block_until_ready()
    assert [len(rows) for (rows,), _ in host.call_args_list] == [6]
    alone = program(env, "step")(jax.tree.map(lambda leaf: leaf[1, 2], states), action)
    np.testing.assert_allclose(nested.obs[1, 2], alone.obs, rtol=1e-6, atol=1e-6)


def test_the_sensors_lag_the_state_by_one_substep():
    env = make("sawyer_door", substeps=1)
    state = first_state(env)
    after = program(env, "step")(state, jnp.array([1.0, 1.0, -1.0, 1.0]))
    np.testing.assert_allclose(after.obs[:3], state.obs[:3], atol=1e-6)
    assert np.abs(np.asarray(after.data.qpos[:9] - state.data.qpos[:9])).max() > 1e-4


@pytest.mark.parametrize("engine", ["c", "mjx"])
def test_states_and_controls_of_other_shapes_are_refused_by_name(engine):
    """One control used to drive all actuators on `c`; the rest was an error inside XLA without a name."""
    env = make("fish_swim", engine=engine)
    data = first_state(env).data
    for change, size, message in (
        ({}, 1, r"ctrl has shape \(1,\), the model fish_swim takes \(5,\)"),
        ({"qvel": jnp.zeros(14)}, 5, r"qvel has shape \(14,\), .* takes \(13,\)"),
        ({"mocap_pos": jnp.zeros((0, 3))}, 5, r"mocap_pos has shape \(0, 3\), .* takes \(1, 3\)"),
    ):
        with pytest.raises(ValueError, match=message):
            env.simulator.step(data.replace(**change), jnp.zeros(size))


@dataclasses.dataclass(frozen=True)
class Called:
    """An actuator without a method `drive`."""

    motors: MinitaurMotors

    def __call__(self, xp, qpos, qvel, command, memory):
        return self.motors(xp, qpos, qvel, command, memory)


@pytest.mark.parametrize("overheat", [True, False])
def test_motors_drive_the_robot_as_an_actuator_that_c_calls_before_every_substep(overheat):
    env = make("minitaur_pen", engine="c", overheat=overheat)
    state, command = first_state(env).data, jnp.linspace(0, 2, 8)
    hot = jnp.array([0.0, 1.0, 498.0, 499.0, 500.0, 501.0, 0.0, 0.0])
    state = state.replace(memory=state.memory.at[:8].set(hot))
    called = dataclasses.replace(env.simulator, actuator=Called(env.simulator.actuator))
    (actual, _), (expected, _) = jax.jit(called.step)(state, command), jax.jit(env.simulator.step)(state, command)
    assert np.abs(np.asarray(expected.qvel - state.qvel)).max() > 0.1
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5), actual, expected)
