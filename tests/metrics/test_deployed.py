"""Deployed evaluation of policies whose scores are known."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.envs.tabletop import TabletopOrganization
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


class Fragile(TabletopOrganization):
    """Tabletop whose simulation breaks where the gripper leaves the start."""

    name = "fragile"

    def fault(self, state):
        return super().fault(state) | (jnp.abs(state.obs[:2]).max() > 0.5)


def test_a_step_that_breaks_the_simulation_earns_the_reward_of_the_state_before_it(env):
    """An episode that earned nothing from there on would beat those of a policy that keeps to its task."""
    fragile = Fragile(reward_type="dense")
    first = fragile.reset(KEY)

    def leave(obs):
        return jnp.array([1.0, 1.0, -1.0])

    result = jax.jit(lambda: episode(fragile, leave, first, 10))()
    states = [first := fragile.step(first, leave(first.obs)) for _ in range(10)]
    intact = [state for state in states if not fragile.fault(state)]
    assert 0 < len(intact) < 5
    expected = sum(float(state.reward) for state in intact) + (10 - len(intact)) * float(intact[-1].reward)
    assert float(result["return"]) == pytest.approx(expected, rel=1e-5)


def test_an_action_that_is_not_finite_makes_the_return_nan_and_is_no_success(env):
    def broken(obs):
        return jnp.where(obs[0] > 0.3, jnp.nan, jnp.ones(3))

    for task in (env, dataclasses.replace(env, reward_type="dense")):
        result = jax.jit(lambda task=task: episode(task, broken, task.reset(KEY), 10))()
        assert (float(result["success"]), np.isnan(result["return"])) == (0.0, True)


def test_an_unknown_way_to_draw_pairs_and_no_episodes_are_refused(env):
    with pytest.raises(ValueError, match="unknown pairs 'stratified'; choose from random, balanced"):
        deployed(env, idle, KEY, 1, 4, pairs="stratified")
    with pytest.raises(ValueError, match=r"balanced pairs need the task's own starts \(initial\), not uniform ones"):
        deployed(env, idle, KEY, 1, 4, start="uniform", pairs="balanced")
    with pytest.raises(ValueError, match="unknown starts None; choose from initial, uniform, wide"):
        deployed(env, idle, KEY, 1, 4, start=make("franka_kitchen").starts.uniform)
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
    with pytest.raises(InputError, match=r"call it through jax\.pure_callback"):
        deployed(env, policy, KEY, 5, 2)
    with pytest.raises(InputError, match=r"write it in jax\.numpy"):
        deployed(env, lambda obs: jnp.zeros(3) if obs[0] > 0 else jnp.ones(3), KEY, 5, 2)
