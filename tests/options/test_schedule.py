"""The schedule of a run: its defaults, which all ways to start a run share, and its checks."""

import dataclasses
import inspect

import pytest

from earl_jax.cli.train import train as command
from earl_jax.errors import InputError
from earl_jax.options.presets import ALGO
from earl_jax.options.schedule import FIELDS, Schedule, require_whole_windows
from earl_jax.options.seeds import SEEDS
from earl_jax.paper.reproduce import SCALES
from earl_jax.protocol import Continuing, Deployment, Protocol
from earl_jax.sweeps import grid
from earl_jax.training import train


def test_the_shell_sweep_files_and_python_have_the_same_defaults(tmp_path, env):
    shared = {name: value.default for name, value in inspect.signature(train).parameters.items()}
    assert Schedule(**{name: shared[name] for name in FIELDS}) == Schedule()
    assert (shared["seeds"], shared["algo"]) == (SEEDS, ALGO)
    parameters = inspect.signature(command).parameters
    assert all(parameters[name].default is None for name in ("algo", "seeds", *FIELDS))  # what is given is told apart
    help_text = " ".join(command.__doc__.split())
    defaults = [ALGO, *(f"{number:,}" for number in (SEEDS, *dataclasses.astuple(Schedule())))]
    assert [default for default in defaults if f"By default {default}" not in help_text] == []
    (tmp_path / "grid.toml").write_text("envs = 'e'\nalgos = 'a'")
    [spec] = grid.read(tmp_path / "grid.toml")
    assert (spec.seeds, spec.schedule) == (tuple(range(SEEDS)), Schedule())
    for evaluated in (Protocol(200, 200), Deployment().protocol(env), Continuing().protocol(env), SCALES["full"]):
        assert (evaluated.eval_every, evaluated.eval_episodes) == (Schedule.eval_every, Schedule.eval_episodes)


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0, "must lie in"), (2**31, "must lie in"), (1.5, "must be a whole number"), (True, "must be a whole number"),
        ("40", "must be a whole number"), (None, "must be a whole number"),
    ],
)  # fmt: skip
def test_other_values_are_refused_by_name(name, value, message):
    with pytest.raises(InputError, match=f"^{name} {message}"):
        dataclasses.replace(Schedule(), **{name: value}).check()


@pytest.mark.parametrize(
    ("steps", "every", "fix"),
    [
        (100, 33, "eval_every 25 or 50, or steps 99 or 132"),
        (100_003, 10_000, "eval_every 1 or 100003, or steps 100000 or 110000"),
        (50, 200, "eval_every 50, or steps 200"),
    ],
)
def test_training_ends_with_an_evaluation_or_the_nearest_numbers_are_named(steps, every, fix):
    with pytest.raises(InputError, match=f"^steps {steps} is not a multiple of eval_every {every}; choose {fix}$"):
        require_whole_windows(steps, every)
    require_whole_windows(400, 200)
