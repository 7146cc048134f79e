"""Policies of the task without help, after training with a budget."""

import functools
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.learner import sac
from earl_jax.envs import HelpBudget, make
from earl_jax.protocol import Deployment, Protocol
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.training import load_policies, runner, select_seed
from earl_jax.training.evaluation import deployed_lane
from earl_jax.training.policy import Policy, plain_actor
from earl_jax.training.state import Problem
from tests.conftest import tiny_method
from tests.envs.chain import Chain

TABLETOP = make("tabletop_organization")
HELPED = HelpBudget(TABLETOP, budget=5.0)
METHOD = tiny_method("naive")
LENGTHS = {"seeds": (0, 1), "steps": 40, "eval_every": 40, "eval_episodes": 1, "checkpoint_every": 40}


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def agents(env, lanes=2, controllers=1):
    """Return new agents of `env`, leaves [lanes, controllers, ...]."""
    keys = jax.random.split(jax.random.key(0), (lanes, controllers))
    lane_method = select_seed(METHOD, 0)
    return jax.vmap(jax.vmap(lambda key: sac.init(key, lane_method.sac, env.obs_size, env.action_size)))(keys)


def lane_of(env, lane=0):
    return types.SimpleNamespace(agent=jax.tree.map(lambda leaf: leaf[lane], agents(env)), key=jax.random.key(1))


@functools.partial(jax.jit, static_argnums=1)
def expected_action(obs, lane=0):
    """Return the action of the actor that was trained with a budget, at a full budget and without its last component."""
    actor = jax.tree.map(lambda leaf: leaf[lane, 0], agents(HELPED).actor)
    wider = jnp.insert(obs, TABLETOP.state_size, 1.0, axis=-1)
    return sac.greedy(METHOD.sac, actor, wider, HELPED.action_size)[..., :-1]


def test_a_policy_trained_with_a_budget_has_the_sizes_of_the_task_and_observes_a_full_budget():
    policy = Policy.of(HELPED, select_seed(METHOD, 0), lane_of(HELPED))
    assert (policy.obs_size, policy.action_size) == (12, 3)
    obs = jax.random.normal(jax.random.key(2), (5, 12))
    np.testing.assert_allclose(policy(obs), expected_action(obs), atol=1e-6)
    actor = agents(TABLETOP).actor
    assert plain_actor(TABLETOP, actor) is actor


@pytest.mark.parametrize(("cliff", "help_bias"), [(9, 9.0), (3, -9.0)], ids=["requested", "enforced"])
def test_no_intervention_keeps_an_evaluated_policy_from_its_goal(cliff, help_bias):
    """With help, the first agent would stay at its start, and the second one would be brought back from its goal."""
    env = HelpBudget(Chain(start=1, cliff=cliff, goal=3), budget=100.0)
    problem = Problem(env, Protocol(train_horizon=0, eval_horizon=5, eval_episodes=8))
    lane = lane_of(env)
    zeros = jax.tree.map(jnp.zeros_like, lane.agent.actor)
    last = zeros["params"]["hidden_1"]
    last["bias"] = last["bias"].at[..., :2].set(jnp.array([9.0, help_bias]))  # moves right
    lane.agent = lane.agent.replace(actor=zeros)
    metrics = jax.jit(lambda: deployed_lane(problem, select_seed(METHOD, 0), lane, jnp.int32(0)))()
    starts_at = jax.random.split(jax.random.fold_in(jax.random.fold_in(lane.key, 0), 2), 8)
    drawn = jax.jit(jax.vmap(lambda key: env.task.reset(key).info["goal"][0]))(starts_at) == 3
    assert 0 < drawn.sum() < 8
    assert metrics["deployed/success"] == pytest.approx(float(drawn.mean()))


@pytest.fixture
def run(tmp_path):
    config = RunConfig.from_objects(HELPED, METHOD, Deployment(), **LENGTHS)
    resolved = runner.Run.resolve(config, HELPED, METHOD)
    resolved.folder = RunFolder.create(tmp_path / "run", config, HELPED.engine, ())
    return resolved


def assert_loads_the_plain_policies(folder):
    env, policy = load_policies(folder)
    assert env == TABLETOP
    assert (policy.obs_size, policy.action_size) == (12, 3)
    obs = env.reset(jax.random.key(3)).obs
    for lane in (0, 1):
        np.testing.assert_allclose(select_seed(policy, lane)(obs), expected_action(obs, lane), atol=1e-6)


def test_policies_npz_holds_policies_of_the_task_without_help(run):
    state = types.SimpleNamespace(lanes=types.SimpleNamespace(agent=agents(HELPED), visits=None))
    runner.save_policies_of([run], state, 40)
    with np.load(run.folder.policies) as saved:
        assert (int(saved["obs_size"]), int(saved["action_size"])) == (12, 3)
        assert saved["actor['params']['hidden_0']['kernel']"].shape == (2, 12, 16)
        assert saved["actor['params']['hidden_1']['bias']"].shape == (2, 6)
    assert_loads_the_plain_policies(run.folder)


def test_policies_npz_and_the_policy_hold_the_averaged_actor_where_there_is_one(run):
    agent = agents(HELPED)
    agent = agent.replace(averaged=agent.actor, actor=jax.tree.map(jnp.zeros_like, agent.actor))
    runner.save_policies_of([run], types.SimpleNamespace(lanes=types.SimpleNamespace(agent=agent, visits=None)), 40)
    assert_loads_the_plain_policies(run.folder)
    lane = types.SimpleNamespace(agent=jax.tree.map(lambda leaf: leaf[0], agent))
    obs = jnp.full(12, 0.3)
    np.testing.assert_allclose(Policy.of(HELPED, select_seed(METHOD, 0), lane)(obs), expected_action(obs), atol=1e-6)
