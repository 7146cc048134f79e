"""The config of a run: objects to names and options, and back."""

import dataclasses
import json
from fractions import Fraction
from typing import ClassVar

import numpy as np
import pytest
from flax import struct

import earl_jax
from earl_jax.algos import SAC
from earl_jax.algos.naive import Naive
from earl_jax.envs import HelpBudget
from earl_jax.errors import InputError
from earl_jax.protocol import Continuing, Deployment, Protocol, Setting
from earl_jax.runs.config import RunConfig
from tests.conftest import make_config, tiny_method
from tests.envs.chain import Chain


def through_json(config):
    """Return `config` as it comes back from config.json."""
    return RunConfig(**json.loads(json.dumps(dataclasses.asdict(config))))


def test_numbers_of_numpy_are_recorded_as_plain_ones():
    env = earl_jax.make("tabletop_organization", wide=np.True_, train_horizon=np.int64(500))
    method = earl_jax.make_algo("naive", hidden_sizes=(np.int64(16),))
    config = make_config(env, method, setting=Deployment(intervention_chance=np.float32(0.1)), steps=np.int64(80))
    assert through_json(config).values == config.values
    assert (config.env_options, config.setting["intervention_chance"]) == ({"train_horizon": 500, "wide": True}, 0.1)
    assert (config.options, config.steps) == ({"hidden_sizes": (16,)}, 80)


def test_the_setting_and_its_budget_are_restored(env):
    setting = Continuing(goal_change=7, train_horizon=200_000)
    config = make_config(HelpBudget(env, budget=5.0), tiny_method("naive"), setting=setting)
    assert config.setting == {"name": "continuing", "budget": 5.0, "goal_change": 7, "train_horizon": 200_000}
    config = through_json(config)
    assert config.build_env() == HelpBudget(env, budget=5.0)
    assert config.build_setting() == dataclasses.replace(setting, budget=5.0)
    assert config.protocol(config.build_env()) == Protocol(200_000, 200, 40, 2, goal_change=7)


@pytest.mark.parametrize("cls", [type("Rare", (Deployment,), {}), Setting])
def test_a_setting_of_another_class_is_refused(cls):
    """Its run could not be resumed, or had the numbers of the setting with its name."""
    with pytest.raises(InputError, match=f"must be an object of Deployment or Continuing, not of {cls.__name__}"):
        earl_jax.train("tabletop_organization", setting=cls(), steps=10)


def test_the_reward_type_chooses_reward_scale_and_deployed_metric():
    sparse, dense = (earl_jax.make("tabletop_organization", reward_type=kind) for kind in ("sparse", "dense"))
    assert earl_jax.method_for(sparse, "naive").learner.reward_scale == 10.0
    assert earl_jax.method_for(dense, "naive").learner.reward_scale == dense.reward_scale == 1.0
    assert earl_jax.method_for(dense, "naive", reward_scale=10.0).learner.reward_scale == 10.0
    assert earl_jax.method_for(sparse, "naive", learner=earl_jax.SAC(reward_scale=1.0)).learner.reward_scale == 1.0
    for env, metric in ((sparse, "deployed/success"), (dense, "deployed/return")):
        config = make_config(env, earl_jax.method_for(env, "naive"))
        assert config.deployed_metric == metric
        assert config.build_method().learner.reward_scale == env.reward_scale


def test_a_class_that_its_name_does_not_build_is_recorded_and_required(env):
    class Impostor(Naive):
        """Another class under a registered name."""

    config = make_config(env, Impostor())
    assert config.env_class is None
    assert config.algo_class == f"{__name__}:{Impostor.__qualname__}"
    with pytest.raises(ValueError, match="not registered here; another class has its name; pass the object"):
        config.build_method()


@pytest.mark.usefixtures("registries")
def test_a_class_of_ones_own_is_built_as_it_was_after_its_defaults_have_changed():
    """Without its defaults, a run of an edited class would be resumed and pooled as another one."""

    def registered(default_pace, default_steps):
        class Paced(Naive):
            name: ClassVar[str] = "paced"
            pace: float = default_pace
            learner: SAC = SAC(random_steps=default_steps)

        earl_jax.register_algo("paced", Paced)
        return Paced()

    config = through_json(make_config(Chain(), registered(0.5, 7)))
    assert config.options.items() >= {"pace": 0.5, "random_steps": 7}.items()
    assert "batch_size" not in config.options, "a default of a learner of this package"
    changed = registered(2.0, 9)
    method = config.build_method()
    assert (method.pace, method.learner.random_steps) == (0.5, 7) != (changed.pace, changed.learner.random_steps)


@pytest.mark.usefixtures("no_training")
def test_an_option_that_json_lacks_can_be_trained_without_a_folder_only(tmp_path):
    class Odd(Naive):
        share: Fraction = struct.field(pytree_node=False, default=Fraction(1))

    method = Odd(share=Fraction(1, 2))
    with pytest.raises(AssertionError, match="training started"):
        earl_jax.train(Chain(), method, steps=2000)
    with pytest.raises(InputError, match=r"written to config\.json \(.* Fraction .*\); train without a folder"):
        earl_jax.train(Chain(), method, steps=2000, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
