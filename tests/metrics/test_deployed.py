"""Deployed evaluation of policies whose scores are known."""

import jax
import jax.numpy as jnp
import pytest

from earl_jax.envs import make
from earl_jax.metrics.deployed import deployed, episode


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


def test_dense_returns_are_undiscounted_sums():
    env = make("tabletop_organization", reward_type="dense")
    result = episode(env, lambda obs: jnp.zeros(3), jax.random.key(0), 7)
    state = env.reset(jax.random.key(0))
    assert float(result["return"]) == pytest.approx(7 * float(env.reward(state.obs)), rel=1e-5)
