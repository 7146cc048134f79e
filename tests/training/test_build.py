"""The task, the method and the setting that names and options describe."""

import dataclasses
from typing import ClassVar

import pytest

import earl_jax
from earl_jax import Continuing
from earl_jax.envs.tabletop import TabletopOrganization
from earl_jax.errors import InputError
from earl_jax.training.build import build, split_options


def test_options_are_split_into_task_setting_and_method():
    options = {"setting": "continuing", "goal_change": 5, "budget": 3, "wide": True, "reward_scale": 1.0}
    env, setting, rest = split_options("tabletop_organization", options)
    assert setting == Continuing(goal_change=5, budget=3)
    assert env == setting.wrap(earl_jax.make("tabletop_organization", wide=True))
    assert rest == {"reward_scale": 1.0}
    env, setting, _ = split_options("tabletop_organization", {"train_horizon": 0, "intervention_chance": 1})
    assert (setting.protocol(env).train_horizon, setting.protocol(env).intervention_chance) == (0, 1)
    env, setting, _ = split_options("sawyer_peg", {"setting": "continuing", "train_horizon": 100_000})
    assert setting.protocol(env).train_horizon == 100_000
    with pytest.raises(InputError, match="tabletop_organization is plain arithmetic: it has no physics engine"):
        split_options("tabletop_organization", {"engine": "mjx"})


@dataclasses.dataclass(frozen=True)
class Discounted(TabletopOrganization):
    """Tabletop with an option that learners have too."""

    name: ClassVar[str] = "discounted"
    discount: float = 1.0


@pytest.mark.usefixtures("registries")
def test_an_option_of_both_the_task_and_the_method_is_refused_and_is_the_tasks_beside_an_object():
    """The task used to take it without a word, and the learner kept its default."""
    earl_jax.register_env("discounted", Discounted)
    with pytest.raises(
        InputError, match="discount is an option of the task 'discounted' and of the method 'naive': pass the"
    ):
        build("discounted", "naive", {"discount": 0.5})
    task, method, _ = build("discounted", earl_jax.make_algo("naive"), {"discount": 0.5})
    assert (task, method.learner.discount) == (Discounted(discount=0.5), 0.99)
