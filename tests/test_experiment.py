"""Run folders: what is in them is either an experiment or one clear error."""

import copy
import json
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from earl_jax import make, make_algo
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.training.runner import per_lane

JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 2**70) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
KEYS = ["env", "env_options", "algo", "options", "seeds", "steps", "eval_every", "setting", "logs", "provenance"]
FUZZ = settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def metrics(value):
    return {"deployed/success": np.array([value, 1.0]), "continuing/reward": np.array([0.5, value])}


@pytest.fixture
def folder(tmp_path):
    env = make("tabletop_organization", reward_type="dense")
    config = RunConfig.of(env, make_algo("fbrl", discount=0.9), (3, 5), 120, 40, 2, 40)
    return RunFolder.create(tmp_path / "run", config)


def fill(folder, *steps):
    for step in steps:
        folder.append(folder.config.rows(step, metrics(step / 7)))


def built(config):
    return config.build_env(), config.build_setting(), per_lane(config.build_method(), 2)


def cause(action):
    """Return what a ValueError says, or nothing; any other error is one of ours."""
    try:
        action()
    except ValueError as error:
        return str(error)
    return ""


@FUZZ
@given(key=st.sampled_from(KEYS), value=JSON, drop=st.booleans())
def test_a_changed_config_is_an_experiment_or_one_clear_error(folder, key, value, drop):
    whole = folder.config.read_text()
    config = copy.deepcopy(json.loads(whole))
    config.pop(key)
    folder.config.write_text(json.dumps(config if drop else {**config, key: value}))
    told = cause(lambda: built(RunFolder.open(folder.path).config))
    folder.config.write_text(whole)
    assert len(told.splitlines()) <= 1


OPTIONS = [
    ("options", name) for name in ("discount", "hidden_sizes", "batch_size", "random_steps", "precision", "layer_norm")
]
OPTIONS += [("env_options", name) for name in ("reward_type", "train_horizon", "wide")]
OPTIONS += [("setting", name) for name in ("name", "intervention_chance", "budget", "goal_change")]


@FUZZ
@given(place=st.sampled_from(OPTIONS), value=JSON)
def test_an_option_of_any_kind_is_taken_or_is_one_clear_error(folder, place, value):
    key, name = place
    whole = folder.config.read_text()
    config = json.loads(whole)
    config[key] = {**config[key], name: value}
    folder.config.write_text(json.dumps(config))
    told = cause(lambda: built(RunFolder.open(folder.path).config))
    folder.config.write_text(whole)
    assert not told or any(word in told for word in (name, "setting", "hyper-parameter"))


@FUZZ
@given(where=st.floats(0, 1, exclude_max=True), text=st.binary(min_size=1, max_size=4))
def test_a_config_overwritten_anywhere_is_an_experiment_or_one_clear_error(folder, where, text):
    whole = folder.config.read_bytes()
    place = int(where * len(whole))
    folder.config.write_bytes(whole[:place] + text + whole[place + len(text) :])
    told = cause(lambda: RunFolder.open(folder.path))
    folder.config.write_bytes(whole)
    assert not told or str(folder.config) in told


@FUZZ
@given(cut=st.integers(0, 400))
def test_a_table_cut_anywhere_goes_on_without_losing_or_doubling_a_row(folder, cut):
    folder.metrics.unlink(missing_ok=True)
    fill(folder, 40, 80, 120)
    whole = folder.metrics.read_bytes()
    cut = min(cut, len(whole))
    folder.metrics.write_bytes(whole[:cut])
    ended = {int(row["step"]) for row in folder.rows()}
    full = [step for step in sorted(ended) if sum(row["step"] == step for row in folder.rows()) == 2]
    last = max(full, default=0)
    assert len(folder.rows_until(last)) == 2 * len(full)
    fill(folder, *range(last + 40, 160, 40))
    assert folder.metrics.read_bytes() == whole


def test_a_damaged_table_names_the_line(folder):
    fill(folder, 40, 80)
    folder.metrics.write_text(folder.metrics.read_text().replace("80,3,", "80,x,"))
    with pytest.raises(ValueError, match=r"metrics\.csv is damaged: line 4 is not a row of numbers"):
        folder.rows()


@pytest.mark.parametrize("name", ["metrics.csv", "checkpoints"])
def test_nothing_in_a_run_folder_leads_out_of_it(folder, name):
    victim = folder.path.parent / "victim"
    victim.write_text("mine")
    (folder.path / name).symlink_to(victim)
    with pytest.raises(ValueError, match=re.escape(f"{folder.path / name} leads out of {folder.path}")):
        RunFolder.open(folder.path)
    assert victim.read_text() == "mine"


def test_a_run_folder_may_itself_be_a_link(folder, tmp_path):
    (tmp_path / "latest").symlink_to(folder.path)
    assert RunFolder.open(tmp_path / "latest").config.seeds == (3, 5)


def test_a_full_disk_is_one_clear_error(folder):
    folder.metrics.symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"metrics\.csv can't be written: No space left .* earl-jax resume .* goes on"):
        fill(folder, 40)


def test_its_name_stays_when_it_is_extended_or_moved(folder, tmp_path):
    before = folder.id
    folder.extended(240)
    moved = RunFolder.open(folder.path.rename(tmp_path / "moved"))
    assert moved.id == before
    assert moved.config.steps == 240
