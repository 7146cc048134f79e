"""Tests of `train --config`: it passes on what the run has, and refuses what would change it."""

import dataclasses
import json
import signal
from unittest.mock import Mock

import pytest

from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.training import api
from earl_jax.training.stopping import Stopped
from tests.cli.process import one_line, run

CONFIG = RunConfig(
    env="tabletop_organization",
    env_options={"wide": True},
    algo="vaprl",
    options={"epsilon": 0.3, "hidden_sizes": [16, 16]},
    seeds=(4, 7),
    steps=400,
    eval_every=40,
    eval_episodes=2,
    checkpoint_every=80,
    reward_type="sparse",
    setting={"name": "continuing", "budget": 20.0, "goal_change": 50},
)


@pytest.fixture
def config_of(monkeypatch, tmp_path):
    """A function that returns the config of the run that `train` with its arguments would train."""
    program = Mock(side_effect=ZeroDivisionError)
    monkeypatch.setattr(api, "Program", program)

    def config_of(*arguments):
        with pytest.raises(ZeroDivisionError):
            run("train", *arguments, "--out", tmp_path / "again")
        [resolved], _ = program.call_args.args
        return resolved.config

    return config_of


@pytest.fixture
def folder(tmp_path):
    return RunFolder.create(tmp_path / "run", CONFIG, "kinematic")


def values(config):
    return RunConfig(**config.values, reward_type=config.reward_type).values


def test_config_repeats_a_run_from_its_folder_or_its_file(config_of, folder):
    assert values(config_of("--config", folder.path)) == CONFIG.values
    assert values(config_of("--config", folder.config_file)) == CONFIG.values
    others = config_of("--config", folder.path, "--seeds", "8:10")
    assert values(others) == dataclasses.replace(CONFIG, seeds=(8, 9)).values


def test_a_list_of_seeds_ends_before_a_task(config_of):
    config = config_of("--seeds", "3", "5:7", "8", "tabletop_organization", "--steps", "1e3", "--eval-every", "500")
    assert (list(config.seeds), config.steps) == ([3, 5, 6, 8], 1000)


@pytest.mark.usefixtures("no_training")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--steps", "800"], "leave out --steps"),
        (["--algo", "fbrl", "--setting", "deployment"], "leave out --algo, --setting"),
        (["--set", "wide=false", "--eval-every", "20"], "leave out --eval-every, --set"),
        (["tabletop_organization"], "leave out the task 'tabletop_organization'"),
        (["--config", "nowhere"], "nowhere does not exist"),
    ],
)
def test_a_missing_config_and_options_that_change_the_run_are_refused(folder, tmp_path, arguments, message):
    one_line(run("train", "--config", folder.path, *arguments, "--out", tmp_path / "again"), message)


@pytest.mark.parametrize("command", ["train", "resume"])
def test_a_signal_leaves_one_json_object(command, folder, monkeypatch):
    stopped = Stopped(signal.SIGTERM, 80, folder.path)
    monkeypatch.setattr(api, command, Mock(side_effect=stopped))
    arguments = ("--config", folder.path, "--out", folder.path) if command == "train" else (folder.path,)
    code, out, err = run(command, *arguments, "--json")
    repeat = f"earl-jax resume {folder.path}"
    assert (code, err) == (128 + signal.SIGTERM, f"earl-jax: {stopped}\n")
    assert json.loads(out) == {"out": str(folder.path), "resume": repeat, "steps": 80, "stopped": True}
    assert run(command, *arguments)[1] == ""


def test_a_preset_gives_lengths_and_options_and_what_is_given_besides_wins(config_of):
    config = config_of("tabletop_organization", "--preset", "quick", "--steps", "400", "--set", "batch_size=16")
    assert (config.seeds, config.steps, config.eval_every) == ((0, 1), 400, 400)
    assert config.options["hidden_sizes"] == (64, 64)
    assert (config.options["batch_size"], config.options["layer_norm"]) == (16, True)
    paper = config_of("sawyer_door", "--preset", "paper", "--steps", "100000")
    assert (paper.seeds, paper.steps, paper.options) == (tuple(range(5)), 100_000, {})
    assert config_of("sawyer_door", "--preset", "paper").steps == 4_000_000
