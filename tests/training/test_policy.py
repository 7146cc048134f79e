"""Policies: of the task without help after training with a budget, and those that ship, which reach what they claim."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from benchmarks import pretrained as packing
from earl_jax import SAC, assets
from earl_jax.envs import HelpBudget, make
from earl_jax.metrics.deployed import deployed
from earl_jax.runs.folder import RunFolder
from earl_jax.training import load_policies, pretrained_env, runner, select_seed
from earl_jax.training.policy import Policy, actor_of_arrays
from tests.conftest import make_config, make_problem, make_train_state, take_lane, tiny_method

NAME = "tabletop_organization"


@pytest.mark.parametrize("averaged", [False, True])
def test_policies_npz_holds_policies_of_the_task_without_help_of_the_averaged_actor_if_there_is_one(tmp_path, averaged):
    task, method = make(NAME), tiny_method("naive")
    helped = HelpBudget(task, budget=5.0)
    config = make_config(helped, method)
    run = runner.Run.resolve(config, helped, method)
    run.folder = RunFolder.create(tmp_path / "run", config, "kinematic", ())
    lanes = make_train_state(make_problem(helped), method, [0, 1]).lanes
    actor = jax.tree.map(lambda leaf: leaf[:, 0], lanes.agent.actor)
    if averaged:
        zeros = jax.tree.map(jnp.zeros_like, lanes.agent.actor)
        lanes = lanes.replace(agent=lanes.agent.replace(averaged=lanes.agent.actor, actor=zeros))
    runner.save_policies_of([run], run.method, lanes, 40)
    with np.load(run.folder.policies) as saved:
        assert (int(saved["obs_size"]), int(saved["action_size"])) == (12, 3)
        assert saved["actor['params']['hidden_0']['kernel']"].shape == (2, 13, 16), "with the budget"
        assert saved["actor['params']['hidden_1']['bias']"].shape == (2, 8)
    policy = load_policies(run.folder)
    obs = task.reset(jax.random.key(3)).obs
    with_full_budget = jnp.insert(obs, task.state_size, 1.0)
    greedy = jax.jit(method.learner.greedy)
    for lane in (0, 1):
        expected = greedy(take_lane(actor, lane), with_full_budget)[:-1]
        of_lane = Policy.of(helped, take_lane(method, lane), take_lane(lanes, lane))
        for loaded in (select_seed(policy, lane), of_lane):
            np.testing.assert_allclose(loaded(obs), expected, atol=1e-6)


class Mirrored(SAC):
    """Its deployed actor depends on the axes of the agent and on an option of the lane."""

    name = "mirrored"

    def deployed(self, agent):
        return jax.tree.map(lambda leaf: self.discount * leaf[::-1], agent.actor)


def test_a_learner_deploys_the_agent_of_one_controller_of_one_lane(tmp_path):
    """It used to get the agents of all controllers, and in policies.npz of all lanes too."""
    env, method = make(NAME), tiny_method("fbrl", learner=Mirrored(), discount=[0.5, 0.9])
    config = make_config(env, method)
    run = runner.Run.resolve(config, env, method)
    run.folder = RunFolder.create(tmp_path / "run", config, "kinematic", ())
    lanes = make_train_state(make_problem(env), method, [0, 1]).lanes
    runner.save_policies_of([run], run.method, lanes, 40)
    kernel = np.asarray(lanes.agent.actor["params"]["hidden_0"]["kernel"][:, 0])
    expected = np.float32([0.5, 0.9])[:, None, None] * kernel[:, ::-1]
    with np.load(run.folder.policies) as saved:
        np.testing.assert_allclose(saved["actor['params']['hidden_0']['kernel']"], expected, rtol=1e-6)
    for lane in (0, 1):
        policy = Policy.of(env, take_lane(method, lane), take_lane(lanes, lane))
        np.testing.assert_allclose(policy.actor["params"]["hidden_0"]["kernel"], expected[lane], rtol=1e-6)


EPISODES = 20
SHIPPED = [(task, method) for task, methods in earl_jax.list_pretrained().items() for method in methods]


@functools.cache
def run_of(env):
    """Return the evaluation of policies on `env`: one program for those of a size."""
    return jax.jit(lambda policy: deployed(env, policy, jax.random.key(3), env.eval_horizon, EPISODES))


@pytest.mark.parametrize(
    ("task", "method"), [pytest.param(*pair, marks=() if pair[0] == NAME else pytest.mark.slow) for pair in SHIPPED]
)
def test_a_policy_that_ships_reaches_the_success_that_it_claims(task, method):
    results = run_of(pretrained_env(task, method))(earl_jax.pretrained(task, method))
    claim = earl_jax.pretrained_info(task, method)["deployed/success"][0]
    assert float(results["deployed/success"]) >= packing.lowest(claim, EPISODES)


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


def test_a_policy_acts_under_strict_promotion_of_types_and_ranks():
    policy, obs = earl_jax.pretrained(NAME, "fbrl"), np.full(12, 0.1, np.float32)
    action = policy(obs)
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        np.testing.assert_array_equal(policy(obs), action)


def test_a_policy_is_compiled_once_for_observations_of_a_shape():
    traced = []

    class Counted(SAC):
        def greedy(self, actor, obs):
            traced.append(obs.shape)
            return super().greedy(actor, obs)

    policy = earl_jax.pretrained(NAME, "fbrl").replace(learner=Counted())
    for _ in range(3):
        policy(np.zeros(12))
    assert traced == [(12,)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere", "fbrl"), f"no trained policies ship for 'nowhere'; choose from .*{NAME}"),
        (("tabletop_manipulation", "fbrl"), f"no trained policies ship for .*; did you mean '{NAME}'"),
        ((NAME, "nothing"), f"no policies of 'nothing' ship for {NAME}; choose from cfbrl, fbrl, naive"),
        ((NAME, "fbrl", 99), r"no seed 99 of fbrl on tabletop_organization ships; choose from \d"),
    ],
)
def test_unknown_names_list_the_choices(arguments, message):
    with pytest.raises(ValueError, match=message):
        earl_jax.pretrained(*arguments)


def test_a_greedy_action_of_another_size_and_a_stack_of_policies_are_refused():
    """A learner that returned the deviations too used to be cut to the size of the action without a word."""

    class Wide(SAC):
        name = "wide"

        def greedy(self, actor, obs):
            return jnp.zeros((*obs.shape[:-1], 6))

    env = make(NAME)
    with pytest.raises(ValueError, match=r"greedy of 'wide' returns must be number\[2, 3\], not float32\[2, 6\]"):
        Policy.of_actor(env, Wide(), None)(jnp.zeros((2, env.observation_size)))
    with pytest.raises(ValueError, match=r"a stack of policies: use jax\.vmap"):
        Policy.of_actor(env, Wide(discount=np.full(2, 0.9)), None)(jnp.zeros((2, env.observation_size)))


def test_an_actor_survives_its_arrays_up_to_rounding():
    actor = {"params": {"hidden_0": {"kernel": jnp.array([[1.0, 1e-3]]), "bias": jnp.array([0.1, -2.0])}}}
    restored = actor_of_arrays(packing.arrays_of_actor(actor))
    assert jax.tree.structure(restored) == jax.tree.structure(actor)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3), restored, actor)
    with pytest.raises(ValueError, match=r"hidden_0\.bias has a weight that is not finite in float16"):
        packing.arrays_of_actor({"params": {"hidden_0": {"kernel": jnp.ones((1, 1)), "bias": jnp.array([1e6])}}})


def test_a_seed_that_rounding_makes_worse_does_not_ship():
    original = {"deployed/success": np.array([1.0, 1.0, 0.6, 0.9])}
    rounded = {"deployed/success": np.array([0.7, 1.0, 0.6, 1.0]), "deployed/return": np.array([9.0, 1.0, 5.0, 2.0])}
    assert packing.chosen_lanes(original, rounded, episodes=100) == [3, 1, 2]


def test_packing_takes_the_best_seeds_of_a_run(whole_run, tmp_path, monkeypatch):
    def scores(env, policies, seed, episodes):
        """Return scores without episodes: the later a seed, the better."""
        lanes = len(jax.tree.leaves(policies.actor)[0])
        return {name: np.linspace(0.6, 1.0, lanes) for name in packing.METRICS}

    monkeypatch.setattr(packing, "scores", scores)
    made = packing.pack(whole_run, tmp_path / "packed", episodes=10)
    assert made["seeds"] == [4, 3]
    assert made["step"] == 2_500_000
    assert len(made["run"]["deployed/success"]) == 5
    with np.load(tmp_path / "packed" / NAME / "r3l.npz") as packed, np.load(whole_run / "policies.npz") as run:
        stored = run["actor['params']['hidden_1']['kernel']"]
        np.testing.assert_array_equal(packed["hidden_1.kernel"], stored[[4, 3]].astype(np.float16))
    with pytest.raises(ValueError, match=r"no seed reaches 1\.1 of its goals"):
        packing.pack(whole_run, tmp_path / "packed", episodes=10, least=1.1)
