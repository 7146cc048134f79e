"""Seeds that are added to a finished run: the files are those of a run of all seeds at once."""

import json
import shutil

import numpy as np
import pytest

import earl_jax
from earl_jax.runs import growth
from earl_jax.runs.folder import RunFolder
from earl_jax.time_limit import TimeLimit
from earl_jax.training import load_lanes
from tests.cli.process import run, snapshot
from tests.conftest import assert_equal_trees, tiny_train


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of four seeds trained at once."""
    path = tmp_path_factory.mktemp("seeds") / "whole"
    tiny_train("naive", seeds=4, out=path)
    return path


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """The folder of the first two of these seeds."""
    path = tmp_path_factory.mktemp("seeds") / "two"
    tiny_train("naive", seeds=2, out=path)
    return path


@pytest.fixture
def folder(two, tmp_path):
    """A copy of `two`."""
    return shutil.copytree(two, tmp_path / "run")


def policies(path):
    with np.load(path / "policies.npz") as file:
        return dict(file)


def assert_equal_folders(path, whole):
    assert (path / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes()
    assert_equal_trees(policies(path), policies(whole))
    merged, expected = (RunFolder.open(each) for each in (path, whole))
    assert merged.config == expected.config
    assert_equal_trees(load_lanes(merged)[2], load_lanes(expected)[2])
    assert sorted(entry.name for entry in path.iterdir()) == sorted(entry.name for entry in whole.iterdir())


def test_added_seeds_give_the_files_of_all_seeds_at_once(folder, whole):
    result = earl_jax.resume(folder, seeds=4)
    assert result.seeds == (0, 1, 2, 3)
    assert result.finished
    assert_equal_folders(folder, whole)
    config = json.loads((folder / "config.json").read_text())
    assert [entry["seeds"] for entry in config["added"]] == [[2, 3]]
    assert config["added"][0]["provenance"]["versions"]
    before = snapshot(folder)
    assert earl_jax.resume(folder, seeds=[3, 0]).seeds == (0, 1, 2, 3)
    assert snapshot(folder) == before


def test_the_command_line_continues_after_its_minutes_and_after_a_kill_in_the_merge(folder, whole, monkeypatch):
    monkeypatch.setattr(TimeLimit, "passed", True)
    code, out, _ = run("resume", folder, "--seeds", "2:4", "--minutes", "1")
    assert code == 0
    assert f"earl-jax resume {folder} --seeds 2 3" in out
    assert RunFolder.open(folder).config.seeds == (0, 1)
    monkeypatch.undo()
    code, _, err = run("resume", folder, "--seeds", "6")
    assert code == 2
    assert "holds the unfinished seeds 2 3; finish them with: earl-jax resume" in err

    real = growth._move_merged
    monkeypatch.setattr(growth, "_move_merged", lambda path: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        earl_jax.resume(folder, seeds=4)
    with pytest.raises(ValueError, match=f"being merged into {folder}; if that was killed: earl-jax resume {folder}"):
        RunFolder.open(folder)
    (folder / "merged_seeds/policies.npz").replace(folder / "policies.npz")  # a kill after the first files
    monkeypatch.setattr(growth, "_move_merged", real)
    code, out, _ = run("resume", folder)
    assert (code, "over 4 seeds" in out) == (0, True)
    assert_equal_folders(folder, whole)


def test_only_a_finished_run_with_its_checkpoint_takes_seeds(folder):
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**config, "steps": 160}))
    with pytest.raises(ValueError, match="no checkpoint of its last step 160; finish it first with: earl-jax resume"):
        earl_jax.resume(folder, seeds=3)
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "config.json").write_text(json.dumps({**config, "engine": "mjx"}))
    with pytest.raises(ValueError, match="trained with the physics engine mjx, and here it would be kinematic"):
        earl_jax.resume(folder, seeds=3)
    shutil.rmtree(folder / "checkpoints")
    with pytest.raises(ValueError, match=r"without its checkpoint .* earl-jax train --config"):
        earl_jax.resume(folder, seeds=3)


def test_values_for_each_seed_cannot_be_extended(folder):
    config = json.loads((folder / "config.json").read_text())
    options = {**config["options"], "discount": [0.9, 0.99]}
    (folder / "config.json").write_text(json.dumps({**config, "options": options}))
    with pytest.raises(ValueError, match="a value for each seed"):
        earl_jax.resume(folder, seeds=4)


def test_tables_of_other_versions_are_not_merged(folder, tmp_path):
    tables = [RunFolder.open(shutil.copytree(folder, tmp_path / name)) for name in ("a", "b")]
    text = tables[1].metrics.read_text()
    tables[1].metrics.write_text(text.replace("interventions", "resets", 1))
    with pytest.raises(ValueError, match=r"differ in their columns \(interventions, resets\)"):
        growth.merged_table(*tables)
    tables[1].metrics.write_text("".join(text.splitlines(keepends=True)[:-1]))
    with pytest.raises(ValueError, match="ends at step 80 of 120"):
        growth.merged_table(*tables)
