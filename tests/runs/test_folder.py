"""Run folders: any content is a valid run or one clear error."""

import contextlib
import dataclasses
import errno
import json
import os
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st

from earl_jax import make, make_algo
from earl_jax.runs.files import RunWarning
from earl_jax.runs.folder import RunFolder
from earl_jax.training.plan import per_lane
from tests.cli.process import unchanged
from tests.conftest import make_config

JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 2**70) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
KEYS = ["env", "env_options", "algo", "options", "seeds", "steps", "eval_every", "setting", "logs", "provenance"]
OPTIONS = {
    "options": ["discount", "hidden_sizes", "batch_size", "random_steps", "precision", "layer_norm"],
    "env_options": ["reward_type", "train_horizon", "wide"],
    "setting": ["name", "intervention_chance", "budget", "goal_change"],
}
PLACES = [(key,) for key in KEYS] + [(key, name) for key, names in OPTIONS.items() for name in names]
FUZZ = settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def folder(tmp_path):
    env = make("tabletop_organization", reward_type="dense")
    config = make_config(env, make_algo("fbrl", discount=0.9), seeds=(3, 5))
    return RunFolder.create(tmp_path / "a run", config, "kinematic")


def append_rows(folder, *steps):
    for step in steps:
        metrics = {"deployed/success": np.array([step / 7, 1.0]), "continuing/reward": np.array([0.5, step / 7])}
        folder.append(step, metrics)


def build(config):
    return config.build_env(), config.build_setting(), per_lane(config.build_method(), 2)


def message_with(folder, content, use=build):
    """Return the message of a ValueError of `use` on another config.json, or ""; any other error is a bug."""
    original = folder.config_file.read_bytes()
    folder.config_file.write_bytes(content)
    try:
        use(RunFolder.open(folder.path).config)
    except ValueError as error:
        return str(error)
    finally:
        folder.config_file.write_bytes(original)
    return ""


@settings(FUZZ, max_examples=200)
@given(place=st.sampled_from(PLACES), value=JSON, drop=st.booleans())
@example(place=("env_options",), value={"\r": 2**63}, drop=False)
def test_a_changed_config_is_valid_or_one_line_that_names_the_option(folder, place, value, drop):
    *above, name = place
    config = json.loads(folder.config_file.read_text())
    values = config[above[0]] if above else config
    values.pop(name, None)
    values |= {} if drop else {name: value}
    message = message_with(folder, json.dumps(config).encode())
    assert len(message.splitlines()) <= 1
    assert not (above and message) or any(word in message for word in (name, "setting", "hyper-parameter"))


@FUZZ
@given(where=st.floats(0, 1, exclude_max=True), text=st.binary(min_size=1, max_size=4))
def test_an_overwritten_config_is_valid_or_one_error_that_names_the_file(folder, where, text):
    original = folder.config_file.read_bytes()
    start = int(where * len(original))
    message = message_with(folder, original[:start] + text + original[start + len(text) :], use=id)
    assert not message or str(folder.config_file) in message


@FUZZ
@given(cut=st.integers(0, 400))
def test_a_truncated_table_is_continued_without_losing_or_repeating_a_row(folder, cut):
    folder.metrics.unlink(missing_ok=True)
    append_rows(folder, 40, 80, 120)
    original = folder.metrics.read_bytes()
    folder.metrics.write_bytes(original[:cut])
    lines = original[:cut].splitlines(keepends=True)
    whole = not lines or not lines[0].endswith(b"\n") or (len(lines) % 2 == 1 and lines[-1].endswith(b"\n"))
    with contextlib.nullcontext() if whole else pytest.warns(RunWarning, match="read up to its last whole evaluation"):
        last = folder.table().step
    assert folder.table_until(last).step == last == 40 * max(0, (original[:cut].count(b"\n") - 1) // 2)
    append_rows(folder, *range(last + 40, 160, 40))
    assert folder.metrics.read_bytes() == original


def test_a_full_disk_is_one_clear_error(folder, monkeypatch):
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(errno.ENOSPC, "No space left on device")))
    with pytest.raises(OSError, match=r"metrics\.csv can't be written: No space left .* earl-jax resume .* continues"):
        append_rows(folder, 40)


def test_the_id_stays_when_the_run_is_extended_or_moved_or_read_through_a_link_and_is_text(folder, tmp_path):
    before = folder.id
    folder.record(steps=240)
    moved = RunFolder.open(folder.path.rename(tmp_path / "moved"))
    (tmp_path / "latest").symlink_to(moved.path)
    assert moved.id == RunFolder.open(tmp_path / "latest").id == before
    assert moved.config.steps == 240
    moved.record(id=1)
    with pytest.raises(ValueError, match="it has no id"):
        _ = moved.id


def create(folder, **options):
    config = dataclasses.replace(folder.config, seeds=(1, 2, 3))
    return RunFolder.create(folder.path, config, "kinematic", **options)


def fill(folder):
    """Put every entry that a run writes into its folder."""
    append_rows(folder, 40)
    (folder.path / "policies.npz").write_bytes(b"x")
    (folder.path / "checkpoints/000000040/lanes").mkdir(parents=True)
    (folder.path / "checkpoints/000000080.part").mkdir()
    (folder.path / "tensorboard").mkdir()
    (folder.path / "tensorboard/events.out.tfevents.1").write_bytes(b"x")
    (folder.path / "wandb").mkdir()
    (folder.path / ".nfs0001").write_bytes(b"which NFS keeps while another process reads it")


BEFORE_RESULTS = {
    "config": lambda folder: None,
    "damaged config": lambda folder: folder.config_file.write_text("{"),
    "header": lambda folder: folder.metrics.write_text("step,seed,deployed/success\n40,3,0."),
    "logs": lambda folder: (folder.path / "tensorboard").mkdir(),
    "unfinished checkpoint": lambda folder: (folder.path / "checkpoints/000000040.part/lanes").mkdir(parents=True),
}
RESULTS = {
    "rows": lambda folder: append_rows(folder, 40),
    "rows of old Macs": lambda folder: folder.metrics.write_bytes(b"step,seed\r40,3\r"),
    "rows without a header": lambda folder: folder.metrics.write_text("40,3,0.5\n"),
    "policies": lambda folder: (folder.path / "policies.npz").write_bytes(b"x"),
    "checkpoint": lambda folder: (folder.path / "checkpoints/000000040").mkdir(parents=True),
}


@pytest.mark.parametrize("state", BEFORE_RESULTS)
def test_a_folder_without_results_is_used_by_the_next_run(folder, state, capsys):
    BEFORE_RESULTS[state](folder)
    assert RunFolder.open(create(folder).path).config.seeds == (1, 2, 3)
    assert not folder.metrics.exists()
    assert not folder.checkpoints.exists()
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc, in which nobody can create a folder")
def test_a_folder_that_cannot_be_created_is_named_with_the_cause(folder):
    path = Path("/proc/earl_jax/run")
    with pytest.raises(OSError, match=f"^{path} can't be created: No such file or directory; choose another folder"):
        RunFolder.create(path, folder.config, "kinematic")


@pytest.mark.parametrize("state", RESULTS)
def test_a_folder_with_results_is_replaced_only_on_request(folder, state, capsys):
    RESULTS[state](folder)
    ways = f"choose another folder, read it with .*, continue it with: earl-jax resume '{folder.path}', .* --overwrite"
    refusal = f"holds another run; {ways} .in Python, overwrite=True.$"
    with unchanged(folder.path), pytest.raises(ValueError, match=refusal):
        create(folder)
    with unchanged(folder.path), pytest.raises(ValueError, match="overwrite must be True or False, not 'no'"):
        create(folder, overwrite="no")
    assert RunFolder.open(create(folder, overwrite=True).path).config.seeds == (1, 2, 3)
    message = capsys.readouterr().err
    assert message.startswith(f"earl-jax: removed from the earlier run in {folder.path}: ")
    assert message.count("\n") == 1
    assert sorted(path.name for path in folder.path.iterdir()) == [".lock", "config.json"]


def test_overwriting_names_what_it_removes_and_keeps_the_runs_of_wandb(folder, capsys):
    fill(folder)
    create(folder, overwrite=True)
    assert capsys.readouterr().err.endswith(": checkpoints, tensorboard, policies.npz, metrics.csv\n")
    assert sorted(path.name for path in folder.path.iterdir()) == [".lock", ".nfs0001", "config.json", "wandb"]


UNKNOWN = ["thesis.tex", "checkpoints/thesis.tex", "checkpoints/000000040/thesis.tex", "tensorboard/thesis.tex"]


@pytest.mark.parametrize("name", UNKNOWN)
@pytest.mark.parametrize("link", [False, True])
def test_other_files_and_links_in_a_folder_are_never_removed(folder, name, link):
    fill(folder)
    if link:
        (folder.path / name).symlink_to(folder.path.parent)
    else:
        (folder.path / name).write_text("all of it")
    with unchanged(folder.path), pytest.raises(ValueError, match=f"it holds {name}; move"):
        create(folder, overwrite=True)


def test_overwriting_a_folder_in_use_is_refused(folder):
    fill(folder)
    with unchanged(folder.path), folder.claimed(), pytest.raises(ValueError, match="in use by another process"):
        create(folder, overwrite=True)


def test_files_that_another_process_removes_meanwhile_do_not_matter(folder, monkeypatch):
    trial, scan = folder.checkpoints / "trial.part", os.scandir
    trial.mkdir(parents=True)

    def remove_and_scan(path="."):
        if str(path) == str(trial) and trial.exists():
            trial.rmdir()
        return scan(path)

    monkeypatch.setattr(os, "scandir", remove_and_scan)
    assert create(folder).path == folder.path
    assert not trial.exists()


def test_a_folder_that_another_process_took_over_is_not_used(folder):
    create(folder)
    with pytest.raises(ValueError, match="another process has just started another run"), folder.claimed():
        pass


def test_a_folder_of_runs_is_refused_with_runs_of_a_sweep_in_it(folder, tmp_path):
    sweep = tmp_path / "sweep"
    (sweep / "task/method").mkdir(parents=True)
    folder.path.rename(sweep / "task/method/default")
    with pytest.raises(ValueError, match=r"not a run folder.*did you mean .*/sweep/task/method/default"):
        RunFolder.open(sweep)


def test_the_engine_that_trains_is_recorded(folder):
    folder.record(engine="mjx")
    assert json.loads(folder.config_file.read_text())["engine"] == "mjx"
    written = folder.config_file.stat().st_mtime_ns
    folder.record(engine="mjx")
    assert folder.config_file.stat().st_mtime_ns == written
