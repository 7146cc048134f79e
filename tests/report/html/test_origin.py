"""Commands and versions of the runs of a page."""

import dataclasses
import json
import shlex

import pytest

from earl_jax.cli.main import main
from earl_jax.protocol import Continuing, Deployment
from earl_jax.report.html.content import _facts
from earl_jax.report.html.lines import gather
from earl_jax.report.html.origin import command
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.training import api
from tests.report.run_files import rising, write_page_run

SETTINGS = [Deployment(), Continuing(budget=2.0, goal_change=7)]
OPTIONS = {"hidden_sizes": (8, 8), "precision": "bf16", "reward_scale": 3.0}


def write_config(path, **options):
    """Return the config of a run, read from its folder."""
    run = write_page_run(path, "fbrl", rising(2, 3), env_options={"wide": True}, **OPTIONS, **options)
    return RunFolder.open(run).config


class TrainingStartedError(Exception):
    """Ends a command where it would start to train."""


@pytest.mark.parametrize("setting", SETTINGS, ids=[setting.name for setting in SETTINGS])
def test_the_command_of_a_run_trains_the_same_run(tmp_path, setting, monkeypatch):
    config = write_config(tmp_path / "run", setting=setting)
    arguments = {}

    def train(env, algo, **options):
        arguments.update(options, objects=(env, algo))
        raise TrainingStartedError

    monkeypatch.setattr(api, "train", train)
    with pytest.raises(TrainingStartedError):
        main(shlex.split(command(config))[1:])
    counts = {name: arguments[name] for name in ("steps", "eval_every", "eval_episodes", "checkpoint_every")}
    again = RunConfig.from_objects(
        *arguments["objects"], arguments["setting"], seeds=range(arguments["seeds"]), **counts
    )
    assert json.loads(json.dumps(dataclasses.asdict(again))) == json.loads(json.dumps(dataclasses.asdict(config)))


def test_seeds_that_do_not_count_from_0_need_a_python_call(tmp_path):
    config = write_config(tmp_path / "run", seeds=(3, 4))
    text = command(config)
    assert text.startswith(
        "earl_jax.train('tabletop_organization', 'fbrl', setting='deployment', seeds=[3, 4], steps=30"
    )
    assert "wide=True" in text


def test_a_page_shows_which_commits_had_changes(tmp_path):
    for name, commit in (("clean", "a" * 40), ("changed", "a" * 40 + "-dirty"), ("unrecorded", None)):
        file = write_page_run(tmp_path / name, "fbrl", rising(2, 3)) / "config.json"
        values = json.loads(file.read_text())
        file.write_text(json.dumps({**values, "provenance": {"commit": commit}}))
    runs = [run for name in ("clean", "changed", "unrecorded") for run in gather([tmp_path / name])[0][0].runs]
    assert dict(_facts([], runs))["Commit"] == "aaaaaaaaa, aaaaaaaaa-dirty, unknown"
