"""Continuing evaluation: the reward of a lifetime."""

import jax
import jax.numpy as jnp
import pytest

from earl_jax.metrics.continuing import Counters, continuing

COUNTERS = Counters(
    window_reward=jnp.asarray(3.0),
    total_reward=jnp.asarray(0.0),
    interventions=jnp.asarray(2),
    faults=jnp.asarray(1),
    reached=jnp.asarray(4),
    diagnostics={},
    life=None,
)


def test_continuing_reward_is_the_average_over_the_lifetime_and_recent_over_the_window(env):
    env_state = env.reset(jax.random.key(0))
    counters, metrics = continuing(COUNTERS, env_state, jnp.asarray(10.0), jnp.asarray(10.0))
    assert float(metrics["continuing/reward"]) == float(metrics["continuing/recent"]) == pytest.approx(0.3)
    counters = counters.replace(window_reward=counters.window_reward + 1.0)
    _, metrics = continuing(counters, env_state, jnp.asarray(20.0), jnp.asarray(10.0))
    assert float(metrics["continuing/reward"]) == pytest.approx(0.2)
    assert float(metrics["continuing/recent"]) == pytest.approx(0.1)


def test_counts_are_reported_unchanged(env):
    _, metrics = continuing(COUNTERS, env.reset(jax.random.key(0)), jnp.asarray(10.0), jnp.asarray(10.0))
    assert {name: int(metrics[name]) for name in ("interventions", "faults", "reached")} == {
        "interventions": 2, "faults": 1, "reached": 4
    }  # fmt: skip
