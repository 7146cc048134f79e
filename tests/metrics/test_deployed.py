"""Deployed evaluation of policies whose scores are known."""

import jax
import jax.numpy as jnp
import pytest

from earl_jax.envs import make
from earl_jax.metrics.deployed import WIDE, deployed, episode

GOAL = jnp.tile(jnp.array([0.0, 0.0, 0.0, 2.0, -1.0, -1.0]), 2)
"""An observation that has reached its goal."""


def test_an_expert_always_succeeds_and_an_idle_policy_never_does(env):
    key = jax.random.key(0)
    expert = deployed(env, env.expert, key, env.eval_horizon, 10)
    assert float(expert["deployed/success"]) == 1.0
    assert float(expert["deployed/return"]) > 100
    idle = deployed(env, lambda obs: jnp.zeros(3), key, env.eval_horizon, 10)
    assert float(idle["deployed/success"]) == float(idle["deployed/return"]) == 0.0


def test_success_counts_at_any_step_within_the_horizon(env):
    results = [float(episode(env, env.expert, jax.random.key(1), horizon)["success"]) for horizon in (10, 60)]
    assert results == [0.0, 1.0]
    leaving = deployed(env, lambda obs: jnp.where(env.success(obs), 1.0, env.expert(obs)), jax.random.key(1), 60, 4)
    assert float(leaving["deployed/success"]) == 1.0


def test_wide_starts_change_no_ordinary_episode(env):
    key = jax.random.key(2)
    plain = deployed(env, env.expert, key, 60, 4)
    both = deployed(env, env.expert, key, 60, 4, wide=env.reset_wide)
    assert {name: float(both[name]) for name in plain} == {name: float(value) for name, value in plain.items()}
    assert float(plain["deployed/return"]) > 1.0
    assert both.keys() - plain.keys() == {WIDE}
    idle = deployed(env, lambda obs: jnp.zeros(3), key, 1, 4, wide=lambda key: env.state_from_demo(GOAL[:6], GOAL[6:]))
    assert float(idle["deployed/success"]) == 0.0
    assert float(idle[WIDE]) == 1.0


def test_dense_returns_are_undiscounted_sums():
    env = make("tabletop_organization", reward_type="dense")
    result = episode(env, lambda obs: jnp.zeros(3), jax.random.key(0), 7)
    state = env.reset(jax.random.key(0))
    assert float(result["return"]) == pytest.approx(7 * float(env.reward(state.obs)), rel=1e-5)
