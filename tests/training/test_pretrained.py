"""Trained policies that ship: they reach the success that they claim, and their files are what the runs had."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from benchmarks import pretrained as packing
from earl_jax import assets
from earl_jax.metrics.deployed import deployed
from earl_jax.training import pretrained_env
from earl_jax.training.policy import actor_of_arrays, arrays_of_actor

TABLETOP = "tabletop_organization"
EPISODES = 20
SHIPPED = [(task, method) for task, methods in earl_jax.list_pretrained().items() for method in methods]


def test_policies_of_the_tabletop_reach_the_success_that_they_claim(env):
    methods = earl_jax.list_pretrained()[TABLETOP]
    policies = [earl_jax.pretrained(TABLETOP, method) for method in methods]
    untrained = policies[0].replace(actor=jax.tree.map(jnp.zeros_like, policies[0].actor))
    actors = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(policy.actor for policy in [*policies, untrained]))

    def success(actor):
        policy = policies[0].replace(actor=actor)
        return deployed(env, policy, jax.random.key(3), env.eval_horizon, EPISODES)["deployed/success"]

    *reached, nothing = np.asarray(jax.jit(jax.vmap(success))(actors))
    claimed = [earl_jax.pretrained_info(TABLETOP, method)["deployed/success"][0] for method in methods]
    assert [share >= packing.lowest(claim, EPISODES) for share, claim in zip(reached, claimed, strict=True)] == [
        True
    ] * len(methods)
    assert nothing < 0.2


@pytest.mark.slow
@pytest.mark.parametrize(("task", "method"), [pair for pair in SHIPPED if pair[0] != TABLETOP])
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


def test_all_policies_together_are_small():
    files = (assets.root() / "pretrained").rglob("*.npz")
    assert 0 < sum(path.stat().st_size for path in files) <= packing.MOST_BYTES_IN_ALL


def test_another_seed_is_another_policy():
    info = earl_jax.pretrained_info(TABLETOP, "fbrl")
    obs = np.full((3, 12), 0.1, np.float32)
    first, second = (earl_jax.pretrained(TABLETOP, "fbrl", seed=seed)(obs) for seed in info["seeds"][:2])
    assert first.shape == (3, 3)
    np.testing.assert_array_equal(first, earl_jax.pretrained(TABLETOP, "fbrl")(obs))
    assert np.abs(first - second).max() > 0.01


def test_the_description_is_the_callers_own():
    earl_jax.pretrained_info(TABLETOP, "fbrl")["seeds"].clear()
    assert earl_jax.pretrained_info(TABLETOP, "fbrl")["seeds"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere", "fbrl"), f"no trained policies ship for 'nowhere'; choose from .*{TABLETOP}"),
        (
            (TABLETOP, "nothing"),
            "no policies of 'nothing' ship for tabletop_organization; choose from cfbrl, fbrl, naive",
        ),
        ((TABLETOP, "fbrl", 99), r"no seed 99 of fbrl on tabletop_organization ships; choose from \d"),
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


RUN = packing.assets.root().parent / "benchmarks" / "results" / "paper" / TABLETOP / "r3l"


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
    with np.load(tmp_path / TABLETOP / "r3l.npz") as packed, np.load(RUN / "policies.npz") as run:
        stored = run["actor['params']['hidden_1']['kernel']"]
        np.testing.assert_array_equal(packed["hidden_1.kernel"], stored[[4, 3]].astype(np.float16))


def test_packing_refuses_a_run_that_learnt_little_and_too_many_bytes(fixed_scores, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"no seed reaches 1\.1 of its goals"):
        packing.pack(RUN, tmp_path, episodes=10, least=1.1)
    monkeypatch.setattr(packing, "MOST_BYTES_IN_ALL", 1000)
    with pytest.raises(ValueError, match="all policies together would have"):
        packing.pack(RUN, tmp_path, episodes=10)
    assert not list(tmp_path.rglob("*.npz"))
