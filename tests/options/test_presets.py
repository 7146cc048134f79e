"""Presets, and the defaults that the shell, sweep files and Python share."""

import inspect

import pytest

import earl_jax
from earl_jax.cli.train import train as command
from earl_jax.options.presets import ALGO, LENGTHS, PRESETS
from earl_jax.sweeps import grid
from earl_jax.training import train


def test_the_shell_sweep_files_and_python_have_the_same_defaults(tmp_path):
    shared = {name: value.default for name, value in inspect.signature(train).parameters.items()}
    assert {name: shared[name] for name in LENGTHS} == LENGTHS
    parameters = inspect.signature(command).parameters
    assert shared["algo"] == parameters["algo"].default == ALGO
    assert all(parameters[name].default is None for name in LENGTHS)  # so that a preset is told from a default
    help_text = " ".join(command.__doc__.split())
    for name, value in LENGTHS.items():
        assert f"By default {value:,}" in help_text, name
    (tmp_path / "grid.toml").write_text("envs = 'e'\nalgos = 'a'")
    [spec] = grid.read(tmp_path / "grid.toml")
    assert {name: getattr(spec, name) for name in LENGTHS} == {**LENGTHS, "seeds": tuple(range(LENGTHS["seeds"]))}


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_arguments_of_train(name):
    values = earl_jax.preset(name, "sawyer_door", seeds=3)
    options = {key: value for key, value in values.items() if key not in LENGTHS}
    assert set(values) - set(options) == set(LENGTHS)
    assert values["seeds"] == 3
    changed = earl_jax.make_algo("fbrl", **options).learner
    assert {key: getattr(changed, key) for key in options} == options
    assert all(getattr(earl_jax.make_algo("fbrl").learner, key) != value for key, value in options.items())


def test_published_steps_need_a_task_of_the_paper():
    assert earl_jax.preset("paper", "minitaur_pen")["steps"] == 3_000_000
    assert "steps" not in earl_jax.preset("paper")
    assert earl_jax.preset("paper", "fish_swim", steps=1000)["steps"] == 1000
    with pytest.raises(ValueError, match=r"'fish_swim' has none; give the steps, or choose from tabletop_organization"):
        earl_jax.preset("paper", "fish_swim")
