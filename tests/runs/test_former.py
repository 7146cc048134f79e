"""Configs of earlier versions mean what they meant when they were written."""

import json

import pytest

from earl_jax import make, make_algo
from earl_jax.protocol import Deployment
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder, read_config
from earl_jax.runs.former import CHANGED, FORMAT, current_values

LENGTHS = {"seeds": (0, 1), "steps": 80, "eval_every": 40, "eval_episodes": 2, "checkpoint_every": 40}
FALSE = {"nearest_fallback": False, "unmet_goals": False}


def config_of(algo, **options):
    return RunConfig.from_objects(make("tabletop_organization"), make_algo(algo, **options), Deployment(), **LENGTHS)


def values_of(algo, options, **more):
    return {**config_of(algo).values, "options": options, **more}


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ({"discount": 0.9}, {"discount": 0.9, **FALSE}),
        ({"unmet_goals": True}, {"nearest_fallback": False}),
        ({"nearest_fallback": True, "unmet_goals": True}, {}),
    ],
)
def test_a_file_without_a_format_keeps_the_defaults_of_its_time(written, read):
    values = current_values(values_of("vaprl", written))
    assert values["options"] == read
    assert current_values(values) == values


def test_methods_whose_defaults_stayed_keep_their_options():
    assert current_values(values_of("fbrl", {"controllers": 1}))["options"] == {"controllers": 1}
    own = values_of("vaprl", {}, algo_class="mine:VaPRL")
    assert current_values(own)["options"] == {}


@pytest.mark.parametrize("options", [{}, FALSE, {"unmet_goals": False}])
def test_a_folder_of_today_reads_as_it_was_written(tmp_path, options):
    config = config_of("vaprl", **options)
    folder = RunFolder.create(tmp_path / "run", config, "kinematic")
    assert json.loads(folder.config_file.read_text())["format"] == FORMAT
    assert RunFolder.open(tmp_path / "run").config == config
    assert config.options == options


@pytest.mark.parametrize("number", [0, FORMAT + 1, "2", None, [2]])
def test_a_format_of_a_later_version_is_an_error(tmp_path, number):
    file = tmp_path / "config.json"
    file.write_text(json.dumps(values_of("vaprl", {}, format=number)))
    with pytest.raises(ValueError, match="this version of earl_jax reads 1 to 2"):
        read_config(file)


def test_todays_defaults_are_those_of_the_methods():
    for algo, options in CHANGED.items():
        for name, (former, today) in options.items():
            assert getattr(make_algo(algo), name) == today != former
