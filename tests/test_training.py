"""Training from Python: shapes, purity, resuming, and options that go astray."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from earl_jax.algos.naive import Naive
from earl_jax.protocol import Protocol
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.training import execute, lifetime, per_lane, select_seed, train
from earl_jax.training.state import Problem
from tests.conftest import ALGOS, TINY, assert_same, tiny_options

RUN = {"seeds": 2, "steps": 120, "eval_every": 40, "eval_episodes": 2}


def tiny_train(algo="fbrl", **options):
    return train("tabletop_organization", algo, **{**RUN, **tiny_options(algo), **options})


@pytest.mark.parametrize("algo", ALGOS)
def test_training_returns_a_leading_seed_axis(algo):
    result = tiny_train(algo)
    np.testing.assert_array_equal(result.steps, [40, 80, 120])
    assert {values.shape for values in result.metrics.values()} == {(2, 3)}
    assert {"deployed/success", "deployed/return", "continuing/reward", "interventions"} <= set(result.metrics)
    assert int(result.lives.step) == 120
    assert all(np.isfinite(values).all() for values in result.metrics.values())
    assert result.metrics["entropy"][0, -1] != result.metrics["entropy"][1, -1]


@pytest.mark.parametrize("algo", ["naive", "vaprl"])
def test_a_lifetime_under_jit_equals_training(env, algo):
    result = tiny_train(algo)
    problem = Problem(env, Protocol(env.train_horizon, env.eval_horizon, eval_every=40, eval_episodes=2))
    method = earl_jax.make_algo(algo, **tiny_options(algo))
    keys = jax.vmap(jax.random.key)(jnp.arange(2))
    lives, metrics = jax.jit(lambda k: lifetime(problem, method, k, 120))(keys)
    for name, values in metrics.items():
        np.testing.assert_allclose(values, result.metrics[name], rtol=1e-3, atol=1e-4, err_msg=name)
    np.testing.assert_allclose(lives.replay.action, result.lives.replay.action, atol=1e-3)


def test_one_seed_is_selected_and_its_policy_can_be_called(env):
    result = tiny_train("fbrl")
    lane = select_seed(result.lives, 1)
    assert lane.world.obs.shape == (env.obs_size,)
    policy = result.policy(1)
    obs = env.reset(jax.random.key(0)).obs
    action = policy(obs)
    assert action.shape == (3,)
    assert (np.abs(action) <= 1).all()
    np.testing.assert_allclose(jax.jit(policy)(jnp.stack([obs, obs]))[1], action, atol=1e-6)
    assert np.abs(result.policy(0)(obs) - action).max() > 1e-6
    with pytest.raises(IndexError, match="no lane 2: there are 2"):
        select_seed(result.lives, 2)
    with pytest.raises(ValueError, match=r"takes \(\.\.\., 12\)"):
        policy(obs[:6])


def test_named_seeds_are_the_same_lives():
    forth, back = tiny_train("naive", seeds=[3, 1]), tiny_train("naive", seeds=[1, 3])
    for name, values in forth.metrics.items():
        np.testing.assert_array_equal(values[::-1], back.metrics[name], err_msg=name)


def test_a_list_gives_each_lane_its_own_hyper_parameter():
    mixed = tiny_train("naive", seeds=[5, 6], reward_scale=[1.0, 5.0], learning_rate=[1e-3, 1e-4])
    same = tiny_train("naive", seeds=[5, 6], reward_scale=5.0, learning_rate=1e-4)
    np.testing.assert_array_equal(mixed.metrics["entropy"][1], same.metrics["entropy"][1])
    assert (mixed.metrics["entropy"][0] != same.metrics["entropy"][0]).any()
    with pytest.raises(ValueError, match="each of 2 lanes"):
        tiny_train("naive", reward_scale=[1.0, 2.0, 3.0])


@pytest.mark.parametrize("algo", ["r3l", "vaprl"])
def test_a_run_resumed_from_its_folder_ends_bit_identical(tmp_path, algo):
    whole = tiny_train(algo, out=tmp_path / "whole", checkpoint_every=40)
    tiny_train(algo, out=tmp_path / "part", checkpoint_every=40, steps=80)
    resumed = RunFolder.open(tmp_path / "part").extended(120)
    result = execute(resumed.config, resumed)
    assert_same(whole.lives.lanes, result.lives.lanes)
    for name, values in whole.metrics.items():
        np.testing.assert_array_equal(values, result.metrics[name])
    assert (tmp_path / "whole/metrics.csv").read_text() == (tmp_path / "part/metrics.csv").read_text()
    assert [path.name for path in sorted((tmp_path / "part/checkpoints").iterdir())] == ["000000080", "000000120"]


def test_dense_rewards_and_other_options_travel_through_the_folder(tmp_path):
    env = earl_jax.make("tabletop_organization", reward_type="dense", wide=True)
    method = earl_jax.make_algo("naive", **tiny_options("naive", reward_scale=0.1))
    train(env, method, out=tmp_path / "run", **RUN)
    config = RunFolder.open(tmp_path / "run").config
    assert config.build_env() == env
    assert_same(config.build_method(), method)


def test_a_task_brings_its_own_reward_scale_and_measure():
    sparse, dense = (earl_jax.make("tabletop_organization", reward_type=kind) for kind in ("sparse", "dense"))
    assert earl_jax.method_for(sparse, "naive").sac.reward_scale == 10.0
    assert earl_jax.method_for(dense, "naive").sac.reward_scale == dense.reward_scale == 1.0
    assert earl_jax.method_for(dense, "naive", reward_scale=10.0).sac.reward_scale == 10.0
    for env, metric in ((sparse, "deployed/success"), (dense, "deployed/return")):
        told = RunConfig.of(env, earl_jax.method_for(env, "naive"), (0,), 40, 40, 1, 40)
        assert told.deployed_metric == metric
        assert told.build_method().sac.reward_scale == env.reward_scale


def test_a_finished_run_stays_finished(tmp_path):
    first = tiny_train("naive", out=tmp_path / "run")
    folder = RunFolder.open(tmp_path / "run")
    again = execute(folder.config, folder)
    assert_same(first.lives.lanes, again.lives.lanes)
    np.testing.assert_array_equal(first.metrics["deployed/success"], again.metrics["deployed/success"])
    with pytest.raises(ValueError, match="has lived 120 steps already"):
        folder.extended(80)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"steps": 100, "eval_every": 40}, "not a multiple of eval_every"),
        ({"seeds": 0}, "at least one and distinct"),
        ({"seeds": [1, 1]}, "at least one and distinct"),
        ({"seeds": [-1]}, "0 to 2"),
        ({"steps": 0}, "steps must be at least 1"),
        ({"eval_episodes": 0}, "eval_episodes must be at least 1"),
        ({"gamma": 0.9}, "no option 'gamma'"),
    ],
)
def test_numbers_that_do_not_fit_are_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        tiny_train("naive", **changed)


def test_lengths_that_share_no_round_number_train_too():
    result = tiny_train("vaprl", steps=50, eval_every=50)
    assert int(result.lives.step) == 50
    assert (result.lives.lanes.method_state.values != 0).all()


def test_a_method_that_nobody_registered_trains_too():
    class Mine(Naive):
        """Naive RL under another name."""

        name = "mine"

    method = Mine(sac=earl_jax.make_algo("naive", **TINY).sac)
    result = train("tabletop_organization", method, **RUN)
    assert result.config.algo == "mine"
    np.testing.assert_array_equal(result.metrics["entropy"], tiny_train("naive").metrics["entropy"])


def test_options_of_a_built_method_are_refused():
    with pytest.raises(ValueError, match="go with an algo's name"):
        train("tabletop_organization", earl_jax.make_algo("naive"), discount=0.9)


def test_integer_leaves_become_floats_and_flags_stay_flags():
    lanes = per_lane(earl_jax.make_algo("naive", reward_scale=3, timeout_bootstrap=True), 3)
    assert lanes.sac.reward_scale.dtype == jnp.float32
    assert lanes.sac.timeout_bootstrap.dtype == bool
    assert lanes.sac.discount.shape == (3,)
