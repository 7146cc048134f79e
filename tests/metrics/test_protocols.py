"""Deployed and continuing evaluation on policies whose scores are known."""

import jax
import jax.numpy as jnp
import pytest

from earl_jax.envs import make
from earl_jax.metrics.continuing import continuing_lane
from earl_jax.metrics.deployed import deployed, deployed_lane, episode
from tests.conftest import advance, newborn, tiny_method


def test_an_expert_always_succeeds_and_idling_never_does(env):
    key = jax.random.key(0)
    best = deployed(env, env.expert, key, env.eval_horizon, 10)
    assert float(best["deployed/success"]) == 1.0
    assert float(best["deployed/return"]) > 100
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


def test_evaluation_is_a_multiple_of_a_tenth_and_leaves_the_life_alone(problem):
    method = tiny_method("naive")
    lives = newborn(problem, method, [0, 1])
    one = jax.tree.map(lambda leaf: leaf[0], (method, lives.lanes))
    first = deployed_lane(problem, *one, lives.step)
    again = deployed_lane(problem, *one, lives.step)
    assert float(first["deployed/success"]) == float(again["deployed/success"])
    assert (float(first["deployed/success"]) * problem.protocol.eval_episodes) % 1 == 0


def test_continuing_reward_is_the_lifetime_average(problem):
    method = tiny_method("naive")
    lane = jax.tree.map(lambda leaf: leaf[0], newborn(problem, method, [0, 1]).lanes)
    lane = lane.replace(counters=lane.counters.replace(window_reward=jnp.asarray(3.0)))
    lane, metrics = continuing_lane(lane, jnp.asarray(10.0), jnp.asarray(10.0))
    assert float(metrics["continuing/reward"]) == float(metrics["continuing/recent"]) == pytest.approx(0.3)
    lane = lane.replace(counters=lane.counters.replace(window_reward=jnp.asarray(1.0)))
    _, metrics = continuing_lane(lane, jnp.asarray(20.0), jnp.asarray(10.0))
    assert float(metrics["continuing/reward"]) == pytest.approx(0.2)
    assert float(metrics["continuing/recent"]) == pytest.approx(0.1)


def test_the_task_is_rewarded_whichever_controller_acts(env, problem):
    """A life that stands on its task goal while the backward controller acts goes on earning."""
    method = tiny_method("fbrl", 1)
    lives = newborn(problem, method, [0])
    goal = jnp.asarray(env.goal_states[1])
    world = lives.lanes.world
    world = world.replace(data=world.data.replace(qpos=goal[None, :4]), obs=jnp.concatenate([goal, goal])[None])
    commands = lives.lanes.commands._replace(goal=jnp.array([4]), task=jnp.array([1]))
    lanes = lives.lanes.replace(world=world, commands=commands, phase=jnp.array([1]))
    after = advance(problem, method, lives.replace(lanes=lanes), 1, explore=True)
    assert float(after.lanes.counters.window_reward[0]) == 1.0
    assert int(after.lanes.counters.reached[0]) == 0
    assert int(after.lanes.phase[0]) == 1
