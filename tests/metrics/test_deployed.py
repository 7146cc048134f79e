"""Deployed evaluation of policies whose scores are known."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.errors import InputError
from earl_jax.metrics.deployed import WIDE, deployed, episode

KEY = jax.random.key(1)


def idle(obs):
    return jnp.zeros(3)


def test_success_counts_at_any_step_within_the_horizon(env):
    def leaving(obs):
        return jnp.where(env.success(obs), 1.0, env.demonstrations.expert(obs))

    def results():
        runs = [episode(env, env.demonstrations.expert, env.reset(KEY), steps)["success"] for steps in (10, 60)]
        return *runs, deployed(env, leaving, KEY, 60, 4)["deployed/success"]

    assert jax.jit(results)() == (0.0, 1.0, 1.0)


def test_wide_starts_change_no_ordinary_episode(env):
    def at_goal(key):
        goal = jnp.array([0.0, 0.0, 0.0, 2.0, -1.0, -1.0])
        return env.demonstrations.state_at(goal, goal)

    runs = [(env.demonstrations.expert, 60, None), (env.demonstrations.expert, 60, env.starts.wide), (idle, 1, at_goal)]
    plain, both, still = jax.jit(lambda: [deployed(env, run, KEY, steps, 4, wide=wide) for run, steps, wide in runs])()
    assert {name: both[name] for name in plain} == plain
    assert plain["deployed/return"] > 1.0
    assert both.keys() - plain.keys() == {WIDE}
    assert (still["deployed/success"], still[WIDE]) == (0.0, 1.0)


def test_dense_returns_are_undiscounted_sums(env):
    dense = dataclasses.replace(env, reward_type="dense")
    total, reward = jax.jit(lambda: (episode(dense, idle, dense.reset(KEY), 7)["return"], dense.reset(KEY).reward))()
    assert float(total) == pytest.approx(7 * float(reward), rel=1e-5)


def test_an_evaluation_has_the_types_of_the_package_whatever_those_of_the_process(env):
    evaluation = functools.partial(deployed, env, idle, horizon=2, episodes=4)
    expected = str(jax.make_jaxpr(evaluation)(KEY))
    with jax.enable_x64(True):
        assert str(jax.make_jaxpr(evaluation)(KEY)) == expected


def test_an_episode_ends_where_the_simulation_breaks(env):
    """The policy's NaN breaks the simulation at once: no success, and a return of the steps before it, not NaN."""
    result = jax.jit(lambda: episode(env, lambda obs: jnp.full(3, jnp.nan), env.reset(KEY), 10))()
    assert (float(result["success"]), float(result["return"])) == (0.0, 0.0)


def test_an_unknown_way_to_draw_pairs_and_no_episodes_are_refused(env):
    with pytest.raises(ValueError, match="unknown pairs 'stratified'; choose from random, balanced"):
        deployed(env, idle, KEY, 1, 4, pairs="stratified")
    for number, arguments in {"episodes": (1, 0), "horizon": (0, 1)}.items():
        with pytest.raises(ValueError, match=rf"{number} must lie in \[1, \d+\], not 0"):
            deployed(env, idle, KEY, *arguments)


def test_a_policy_of_numpy_is_called_from_the_program_or_refused_with_the_way(env):
    def policy(obs):
        return np.tanh(np.asarray(obs)[..., :3])

    def called(obs):
        return jax.pure_callback(policy, jax.ShapeDtypeStruct((3,), jnp.float32), obs, vmap_method="expand_dims")

    dense = dataclasses.replace(env, reward_type="dense")
    expected = deployed(dense, lambda obs: jnp.tanh(obs[:3]), KEY, 5, 2)["deployed/return"]
    assert float(deployed(dense, called, KEY, 5, 2)["deployed/return"]) == pytest.approx(float(expected), rel=1e-4)
    with pytest.raises(InputError, match=r"call it by jax\.pure_callback"):
        deployed(env, policy, KEY, 5, 2)
