"""The scan over training steps: what it computes ahead equals what each step would compute itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.physics import PendingStep
from earl_jax.training import scan
from earl_jax.training.loop import train_step
from earl_jax.training.state import step_keys
from tests.conftest import assert_equal_trees, make_train_state, take_lane, tiny_method


@pytest.mark.parametrize("algo", ["fbrl", "vaprl"])
def test_keys_and_batches_drawn_ahead_are_those_of_each_step(problem, algo, monkeypatch):
    method = tiny_method(algo)
    monkeypatch.setattr(scan, "_draws_ahead", lambda *_: True)

    @jax.jit
    def step(m, state):
        keys = jax.vmap(step_keys, (0, None))(state.lanes.key, state.step)
        return train_step(problem, m, state, keys)

    state = make_train_state(problem, method, [0, 1])
    if method.refresh_every:
        state = scan.refresh(problem, method, state)
    expected, ahead = (
        state,
        jax.jit(lambda m, start: scan._run_block(problem, m, start, 3, explore=False))(method, state),
    )
    for _ in range(3):
        expected = step(method, expected)
    assert int(ahead.step) == 3
    assert_equal_trees(ahead.replay, expected.replay)
    assert_equal_trees(ahead.lanes.env_state, expected.lanes.env_state)
    assert_equal_trees(ahead.lanes.agent, expected.lanes.agent, rtol=1e-5, atol=1e-6)


def test_batches_are_drawn_ahead_on_an_accelerator_unless_the_host_simulates(problem, monkeypatch):
    state = make_train_state(problem, tiny_method("naive"), [0, 1])
    assert not scan._draws_ahead(problem, state), "a CPU gains nothing"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert scan._draws_ahead(problem, state)
    start_step, seen = type(problem.env).start_step, []

    def start_with_ticket(env, env_state, action):
        seen.append((env_state.obs.shape, action.shape))
        return start_step(env, env_state, action)._replace(ticket=jnp.zeros(1, jnp.int32))

    monkeypatch.setattr(type(problem.env), "start_step", start_with_ticket)
    assert not scan._draws_ahead(problem, state)
    lane = take_lane(state.lanes, 0)
    assert seen == [(lane.env_state.obs.shape, (problem.env.action_size,))]
    assert isinstance(start_step(problem.env, lane.env_state, np.zeros(problem.env.action_size)), PendingStep)
