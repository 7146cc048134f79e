"""Presets: arguments of `train` by name."""

import pytest

import earl_jax
from earl_jax.options.presets import PRESETS
from earl_jax.options.schedule import FIELDS


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_arguments_of_train(name):
    values = earl_jax.preset(name, "sawyer_door", seeds=3)
    options = {key: value for key, value in values.items() if key not in ("seeds", *FIELDS)}
    assert set(values) - set(options) == {"seeds", *FIELDS}
    assert values["seeds"] == 3
    changed = earl_jax.make_algo("fbrl", **options).learner
    assert {key: getattr(changed, key) for key in options} == options
    assert all(getattr(earl_jax.make_algo("fbrl").learner, key) != value for key, value in options.items())


def test_published_steps_need_a_task_of_the_paper():
    assert earl_jax.preset("paper", "minitaur_pen")["steps"] == 3_000_000
    with pytest.raises(ValueError, match=r"of a task: preset\('paper', TASK\)"):
        earl_jax.preset("paper")
    assert earl_jax.preset("paper", steps=1000)["steps"] == 1000
    assert earl_jax.preset("paper", "fish_swim", steps=1000)["steps"] == 1000
    with pytest.raises(ValueError, match=r"'fish_swim' has none; give the steps, or choose from tabletop_organization"):
        earl_jax.preset("paper", "fish_swim")
