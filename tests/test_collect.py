"""Runs of another machine become folders of results/paper, with the commit that trained them."""

import json

import numpy as np
import pytest

from benchmarks import collect
from benchmarks.paper_cells import commit_of
from earl_jax.report.runs import read
from tests.report.run_files import DOOR, TABLETOP, rising, write_run

COMMIT = "0123456789abcdef0123456789abcdef01234567"
RECORDED = {"demo_file": "recorded/sawyer_door.npz"}


@pytest.fixture
def sweep(tmp_path):
    """A sweep's folder of a run with policies."""
    folder = write_run(
        tmp_path / "sweep" / TABLETOP / "fbrl" / "default", TABLETOP, "fbrl", rising(3, 4), precision="bf16"
    )
    (folder / "policies.npz").write_bytes(b"policies")
    without_commit(folder)
    return tmp_path / "sweep"


def without_commit(folder):
    config = json.loads((folder / "config.json").read_text())
    config["provenance"]["commit"] = None
    (folder / "config.json").write_text(json.dumps(config))


def test_a_run_comes_to_its_cell_with_its_commit(sweep, tmp_path):
    assert collect.collect([sweep], COMMIT, tmp_path / "paper") == [(f"{TABLETOP}/fbrl", 40, "taken")]
    cell = tmp_path / "paper" / TABLETOP / "fbrl"
    assert sorted(path.name for path in cell.iterdir()) == ["config.json", "metrics.csv", "policies.npz"]
    assert commit_of(cell) == COMMIT
    np.testing.assert_array_equal(read(cell).metrics["deployed/success"], rising(3, 4))


def test_the_commit_that_a_run_names_stays(sweep, tmp_path):
    collect.collect([sweep], COMMIT, tmp_path / "paper")
    collect.collect([tmp_path / "paper"], "f" * 40, tmp_path / "again")
    assert commit_of(tmp_path / "again" / TABLETOP / "fbrl") == COMMIT


@pytest.mark.parametrize(("commit", "message"), [(None, "names no commit; give it with --commit"), ("main", "40 hex")])
def test_without_a_commit_nothing_is_copied(sweep, tmp_path, commit, message):
    with pytest.raises(ValueError, match=message):
        collect.collect([sweep], commit, tmp_path / "paper")
    assert not (tmp_path / "paper").exists()


def test_the_longer_run_stays(sweep, tmp_path):
    collect.collect([sweep], COMMIT, tmp_path / "paper")
    for evaluations, seeds, done in ((3, 5, False), (4, 3, False), (4, 4, True), (5, 2, True)):
        other = write_run(
            tmp_path / f"{evaluations}{seeds}", TABLETOP, "fbrl", rising(seeds, evaluations), precision="bf16"
        )
        [(_, _, text)] = collect.collect([other], COMMIT, tmp_path / "paper")
        assert (text == "taken") == done
    cell = tmp_path / "paper" / TABLETOP / "fbrl"
    assert (read(cell).steps[-1], read(cell).seeds) == (50, 2)
    assert not (cell / "policies.npz").exists(), "they were the shorter run's"


def test_large_policies_and_runs_without_an_evaluation_are_left_out(sweep, tmp_path, monkeypatch):
    monkeypatch.setattr(collect, "LARGEST_POLICIES", 7)
    empty = write_run(sweep / "empty", TABLETOP, "naive", rising(2, 1))
    (empty / "metrics.csv").unlink()
    lines = {name: done for name, _, done in collect.collect([sweep], COMMIT, tmp_path / "paper")}
    assert lines[f"{TABLETOP}/fbrl"].startswith("taken without policies.npz")
    assert lines[str(empty)] == "left out: no evaluation"
    assert not list((tmp_path / "paper").rglob("policies.npz"))


def test_policies_of_a_variant_come_along_at_the_published_length_only(tmp_path):
    lengths = {1: 2_500_000, 2: 2_490_000}
    for controllers, steps in lengths.items():
        options = {"precision": "bf16", "controllers": controllers, "reward_scale": 2.0}
        folder = write_run(tmp_path / "runs" / str(steps), TABLETOP, "fbrl", rising(2, 1), steps=[steps], **options)
        (folder / "policies.npz").write_bytes(b"policies")
    collect.collect([tmp_path / "runs"], COMMIT, tmp_path / "paper")
    [kept] = (tmp_path / "paper").rglob("policies.npz")
    assert kept.parent.name == "controllers_1-reward_scale_2"


@pytest.mark.parametrize(
    ("env", "algo", "run", "name"),
    [
        (TABLETOP, "fbrl", {"precision": "bf16", "controllers": 1}, "fbrl/controllers_1"),
        (TABLETOP, "fbrl", {}, "fbrl/tf32"),
        (DOOR, "vaprl", {"precision": "bf16", "nearest_fallback": False, "unmet_goals": False},
         "vaprl/no_nearest_fallback-no_unmet_goals"),
        (DOOR, "vaprl", {"precision": "bf16", "env_options": RECORDED}, "vaprl/demo_file_recorded"),
        (DOOR, "oracle", {"precision": "bf16", "seeds": [5, 6, 7]}, "oracle/seeds_5_to_7"),
        ("minitaur_pen", "naive", {"precision": "bf16", "reward_scale": 0.1}, "naive"),
        (DOOR, "naive", {"precision": "bf16", "reward_scale": 1.0, "hidden_sizes": (64, 32)},
         "naive/hidden_sizes_64x32-reward_scale_1"),
    ],
)  # fmt: skip
def test_a_variant_is_named_by_its_options(tmp_path, env, algo, run, name):
    folder = write_run(tmp_path / "run", env, algo, rising(3, 2), **run)
    assert collect.run_name(read(folder).config) == f"{env}/{name}"
