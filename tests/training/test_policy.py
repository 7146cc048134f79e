"""Policies: of the task without help after training with a budget, and those that ship, which reach what they claim."""

import functools
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from benchmarks import pretrained as packing
from earl_jax import assets
from earl_jax.algos.learner import sac
from earl_jax.envs import HelpBudget, make
from earl_jax.metrics.deployed import deployed
from earl_jax.protocol import Deployment, Protocol
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.training import load_policies, pretrained_env, runner, select_seed
from earl_jax.training.evaluation import deployed_lane
from earl_jax.training.policy import Policy, actor_of_arrays, arrays_of_actor, plain_actor
from earl_jax.training.state import Problem
from tests.conftest import tiny_method
from tests.envs.chain import Chain

NAME = "tabletop_organization"
TABLETOP = make(NAME)
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


@pytest.mark.parametrize("averaged", [False, True])
def test_policies_npz_holds_policies_of_the_task_without_help_of_the_averaged_actor_if_there_is_one(run, averaged):
    agent = agents(HELPED)
    if averaged:
        agent = agent.replace(averaged=agent.actor, actor=jax.tree.map(jnp.zeros_like, agent.actor))
    runner.save_policies_of([run], types.SimpleNamespace(lanes=types.SimpleNamespace(agent=agent, visits=None)), 40)
    with np.load(run.folder.policies) as saved:
        assert (int(saved["obs_size"]), int(saved["action_size"])) == (12, 3)
        assert saved["actor['params']['hidden_0']['kernel']"].shape == (2, 12, 16)
        assert saved["actor['params']['hidden_1']['bias']"].shape == (2, 6)
    env, policy = load_policies(run.folder)
    assert env == TABLETOP
    assert (policy.obs_size, policy.action_size) == (12, 3)
    obs = env.reset(jax.random.key(3)).obs
    for lane in (0, 1):
        np.testing.assert_allclose(select_seed(policy, lane)(obs), expected_action(obs, lane), atol=1e-6)
    lane = types.SimpleNamespace(agent=jax.tree.map(lambda leaf: leaf[0], agent))
    np.testing.assert_allclose(Policy.of(HELPED, select_seed(METHOD, 0), lane)(obs), expected_action(obs), atol=1e-6)


EPISODES = 20
SHIPPED = [(task, method) for task, methods in earl_jax.list_pretrained().items() for method in methods]


def test_policies_of_the_tabletop_reach_the_success_that_they_claim(env):
    methods = earl_jax.list_pretrained()[NAME]
    policies = [earl_jax.pretrained(NAME, method) for method in methods]
    untrained = policies[0].replace(actor=jax.tree.map(jnp.zeros_like, policies[0].actor))
    actors = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(policy.actor for policy in [*policies, untrained]))

    def success(actor):
        policy = policies[0].replace(actor=actor)
        return deployed(env, policy, jax.random.key(3), env.eval_horizon, EPISODES)["deployed/success"]

    *reached, nothing = np.asarray(jax.jit(jax.vmap(success))(actors))
    claimed = [earl_jax.pretrained_info(NAME, method)["deployed/success"][0] for method in methods]
    assert all(share >= packing.lowest(claim, EPISODES) for share, claim in zip(reached, claimed, strict=True)), reached
    assert nothing < 0.2


@pytest.mark.slow
@pytest.mark.parametrize(("task", "method"), [pair for pair in SHIPPED if pair[0] != NAME])
def test_a_policy_of_a_simulated_task_reaches_the_success_that_it_claims(task, method):
    env, policy = pretrained_env(task, method), earl_jax.pretrained(task, method)
    run = jax.jit(lambda key: deployed(env, policy, key, env.eval_horizon, EPISODES))
    claim = earl_jax.pretrained_info(task, method)["deployed/success"][0]
    assert float(run(jax.random.key(3))["deployed/success"]) >= packing.lowest(claim, EPISODES)


@pytest.mark.parametrize(("task", "method"), SHIPPED)
def test_a_policy_that_ships_is_small_and_described(task, method):
    info, arrays = assets.pretrained(task, method)
    assert 1 <= len(info["seeds"]) <= packing.MOST_SEEDS
    assert {array.dtype for array in arrays.values()} == {np.dtype(np.float16)}
    assert {len(array) for array in arrays.values()} == {len(info["seeds"])}
    assert (info["config"]["env"], info["config"]["algo"]) == (task, method)
    assert set(info["seeds"]) <= set(info["config"]["seeds"])
    assert info["config"]["provenance"]["commit"]
    assert info["deployed/success"][0] >= packing.LEAST
    assert (assets.root() / "pretrained" / task / f"{method}.npz").stat().st_size <= packing.MOST_BYTES
    files = (assets.root() / "pretrained").rglob("*.npz")
    assert sum(path.stat().st_size for path in files) <= packing.MOST_BYTES_IN_ALL


def test_another_seed_is_another_policy_and_the_description_is_the_callers_own():
    info = earl_jax.pretrained_info(NAME, "fbrl")
    obs = np.full((3, 12), 0.1, np.float32)
    first, second = (earl_jax.pretrained(NAME, "fbrl", seed=seed)(obs) for seed in info["seeds"][:2])
    assert first.shape == (3, 3)
    np.testing.assert_array_equal(first, earl_jax.pretrained(NAME, "fbrl")(obs))
    assert np.abs(first - second).max() > 0.01
    info["seeds"].clear()
    assert earl_jax.pretrained_info(NAME, "fbrl")["seeds"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere", "fbrl"), f"no trained policies ship for 'nowhere'; choose from .*{NAME}"),
        ((NAME, "nothing"), f"no policies of 'nothing' ship for {NAME}; choose from cfbrl, fbrl, naive"),
        ((NAME, "fbrl", 99), r"no seed 99 of fbrl on tabletop_organization ships; choose from \d"),
    ],
)
def test_unknown_names_list_the_choices(arguments, message):
    with pytest.raises(ValueError, match=message):
        earl_jax.pretrained(*arguments)


def test_an_actor_survives_its_arrays_up_to_rounding():
    actor = {"params": {"hidden_0": {"kernel": jnp.array([[1.0, 1e-3]]), "bias": jnp.array([0.1, -2.0])}}}
    restored = actor_of_arrays(arrays_of_actor(actor))
    assert jax.tree.structure(restored) == jax.tree.structure(actor)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3), restored, actor)
    with pytest.raises(ValueError, match=r"hidden_0\.bias has a weight that is not finite in float16"):
        arrays_of_actor({"params": {"hidden_0": {"kernel": jnp.ones((1, 1)), "bias": jnp.array([1e6])}}})


def test_a_seed_that_rounding_makes_worse_does_not_ship():
    original = {"deployed/success": np.array([1.0, 1.0, 0.6, 0.9])}
    rounded = {"deployed/success": np.array([0.7, 1.0, 0.6, 1.0]), "deployed/return": np.array([9.0, 1.0, 5.0, 2.0])}
    assert packing.chosen_lanes(original, rounded, episodes=100) == [3, 1, 2]


RUN = packing.assets.root().parent / "benchmarks" / "results" / "paper" / NAME / "r3l"


@pytest.fixture
def fixed_scores(monkeypatch):
    """Scores of the episodes without episodes: the later a seed, the better."""

    def scores(env, policies, seed, episodes):
        lanes = len(jax.tree.leaves(policies.actor)[0])
        return {name: np.linspace(0.6, 1.0, lanes) for name in packing.METRICS}

    monkeypatch.setattr(packing, "scores", scores)


def test_packing_takes_the_best_seeds_of_a_run(fixed_scores, tmp_path):
    made = packing.pack(RUN, tmp_path, episodes=10)
    assert made["seeds"] == [4, 3]
    assert made["step"] == 2_500_000
    assert len(made["run"]["deployed/success"]) == 5
    with np.load(tmp_path / NAME / "r3l.npz") as packed, np.load(RUN / "policies.npz") as run:
        stored = run["actor['params']['hidden_1']['kernel']"]
        np.testing.assert_array_equal(packed["hidden_1.kernel"], stored[[4, 3]].astype(np.float16))


def test_packing_refuses_a_run_that_learnt_little_and_too_many_bytes(fixed_scores, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"no seed reaches 1\.1 of its goals"):
        packing.pack(RUN, tmp_path, episodes=10, least=1.1)
    monkeypatch.setattr(packing, "MOST_BYTES_IN_ALL", 1000)
    with pytest.raises(ValueError, match="all policies together would have"):
        packing.pack(RUN, tmp_path, episodes=10)
    assert not list(tmp_path.rglob("*.npz"))
