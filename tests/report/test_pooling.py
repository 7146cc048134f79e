"""Runs found in folders, and the pools of their seeds."""

import itertools
import os
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

from earl_jax import load
from earl_jax.report import pooling
from earl_jax.report.pooling import find_runs, gather, pooled, read_all, read_methods
from earl_jax.report.runs import labels
from earl_jax.runs.files import RunWarning
from earl_jax.runs.folder import RunFolder
from tests.report.run_files import TABLETOP, change_config, constant, rising, write_page_run, write_run


def test_runs_of_another_class_with_the_name_of_a_method_are_kept_apart_and_labelled_with_it(tmp_path):
    paths = [write_run(tmp_path / name, TABLETOP, "naive", rising(2, 3) / n) for n, name in enumerate("ab", 1)]
    change_config(paths[1], algo_class="lab.methods:Naive")
    assert labels(read_all(paths)) == ["naive", "naive (algo_class=lab.methods:Naive)"]


def test_seeds_of_one_run_that_have_values_of_their_own_are_apart(tmp_path):
    scores = rising(4, 2)
    write_run(
        tmp_path / "lists", TABLETOP, "naive", scores, learning_rate=[3e-4, 1e-3] * 2, timeout_bootstrap=[True] * 4
    )
    write_run(tmp_path / "one", TABLETOP, "naive", scores[:1], seeds=(8,), learning_rate=1e-3, timeout_bootstrap=True)
    default, larger = read_all([tmp_path])
    assert labels([default, larger]) == ["naive (learning_rate=3e-4)", "naive (learning_rate=0.001)"]
    assert (default.run_seeds, larger.run_seeds) == ([0, 2], [1, 3, 8])
    np.testing.assert_allclose(larger.metrics["deployed/success"], scores[[1, 3, 0]])
    change_config(tmp_path / "lists", algo="theirs")
    with pytest.warns(RunWarning, match="lists: its seeds have different values of learning_rate .* --import"):
        assert len(read_all([tmp_path / "lists"])) == 1
    [flags] = read_all([write_run(tmp_path / "flags", TABLETOP, "fbrl", scores, timeout_bootstrap=[0, 0, 0, 1])])[1:]
    assert flags.config.options == {"timeout_bootstrap": True}


def test_a_run_is_left_out_as_a_whole_if_the_seeds_of_one_of_its_values_are_copies(tmp_path):
    write_run(tmp_path / "a", TABLETOP, "naive", rising(2, 3)[1:], seeds=(1,), learning_rate=1e-3)
    write_run(tmp_path / "b", TABLETOP, "naive", rising(2, 3), learning_rate=[1e-2, 1e-3])
    [run], left_out = gather([tmp_path])
    assert (run.run_seeds, list(left_out)) == ([1], [tmp_path / "b"])


def test_pooled_runs_have_the_later_metrics_that_all_of_them_have_in_any_order(tmp_path):
    more = {"continuing/alive": 1, "critic_loss": 0.1, "interventions": 3}
    wide = {"a": {"deployed/success_wide": 0.25, **more}, "b": {"deployed/success_wide": 0.5}, "c": {}}
    paths = [
        write_run(tmp_path / name, TABLETOP, "naive", rising(1, 3), seeds=(seed,), metrics=metrics)
        for seed, (name, metrics) in enumerate(wide.items())
    ]
    for order in (1, -1):
        [run] = read_all(paths[:2][::order])
        np.testing.assert_allclose(run.metrics["deployed/success_wide"][:, 0], [0.25, 0.5][::order])
        assert not more.keys() & run.metrics.keys()
        assert "deployed/success_wide" not in read_all(paths[::order])[0].metrics


def test_each_of_many_runs_is_pooled_once_with_the_earlier_ones(tmp_path, monkeypatch):
    paths = [write_run(tmp_path / str(n), TABLETOP, "naive", rising(1, 2), seeds=(n,)) for n in range(4)]
    parts = []
    monkeypatch.setattr(pooling, "pooled", lambda runs: [parts.append(len(runs)), pooled(runs)][1])
    [run] = read_all(paths)
    assert (parts, run.run_seeds, [folder.path for folder in run.runs]) == ([2, 2, 2], [0, 1, 2, 3], paths)


def test_runs_are_pooled_over_their_common_steps(tmp_path):
    paths = [
        write_run(tmp_path / "a", TABLETOP, "naive", rising(1, 3), reward_scale=2.0),
        write_run(tmp_path / "b", TABLETOP, "naive", rising(1, 2), steps=(20, 40), seeds=(1,), reward_scale=2),
        write_run(tmp_path / "c", TABLETOP, "naive", rising(1, 2), steps=(50, 100), seeds=(2,), reward_scale=2.0),
    ]
    with pytest.warns(RunWarning, match=r"b is pooled with \S*a and counts up to step 20 of 40 only"):
        [run] = read_all(paths[:2])
    np.testing.assert_array_equal(run.steps, [20])
    np.testing.assert_allclose(run.metrics["deployed/success"], [[0.0], [0.5]])
    with pytest.raises(ValueError, match=r"b and \S*c have no evaluation step in common"):
        read_all(paths)


def test_the_score_of_a_pool_does_not_depend_on_the_order_of_its_runs(tmp_path):
    paths = []
    for seed, (every, end) in enumerate(((1, 100), (1, 10), (2, 100))):
        steps = range(every, end + 1, every)
        paths.append(write_run(tmp_path / str(seed), TABLETOP, "naive", [np.divide(steps, end)], steps, [seed]))
    with warnings.catch_warnings(action="ignore"):
        pools = [read_all(order) for order in itertools.permutations(paths)]
    assert len({run.window for [run] in pools}) == 1


def test_a_folder_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    for name in ("a", "closed"):
        write_run(tmp_path / name, TABLETOP, "naive", rising(2, 3))
    scandir = os.scandir

    def refusing(path):
        if Path(path) == tmp_path / "closed":
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refusing)
    with pytest.warns(RunWarning, match="left out: .*closed can't be read: Permission denied"):
        assert find_runs([tmp_path]) == [tmp_path / "a"]


def test_no_runs_are_an_error(tmp_path):
    with pytest.raises(ValueError, match="at least one run folder"):
        read_all([])
    with pytest.raises(ValueError, match=r"no config\.json in it or below"):
        read_all([tmp_path])
    for folders in (tmp_path, str(tmp_path), [1]):
        with pytest.raises(ValueError, match=r"must be a list of paths, such as \['runs'\], not"):
            read_all(folders)


def test_a_folder_is_a_path_a_text_or_that_of_a_result(tmp_path):
    path = write_run(tmp_path / "run", TABLETOP, "naive", rising(1, 2))
    for folder in (path, str(path), RunFolder.open(path)):
        assert [curves.runs[0].path for curves in read_all([folder])] == [path]
        assert load(folder).step == 20


def test_a_folder_of_runs_stands_for_those_that_can_be_read(tmp_path):
    for name, algo in (("x/a", "naive"), ("x/b/c", "fbrl"), ("x/young", "oracle")):
        write_run(tmp_path / name, TABLETOP, algo, rising(1, 2))
    (tmp_path / "x/young/metrics.csv").unlink()
    with pytest.warns(RunWarning, match="left out: .*young has no evaluation yet"):
        assert [curves.config.algo for curves in read_all([tmp_path])] == ["naive", "fbrl"]
    shutil.rmtree(tmp_path / "x/a")
    shutil.rmtree(tmp_path / "x/b")
    with pytest.raises(ValueError, match=r"^\S*young has no evaluation yet$"):
        read_all([tmp_path / "x"])
    with pytest.raises(ValueError, match="nowhere is not a folder"):
        read_all([tmp_path / "nowhere"])


def test_run_folders_are_found_once_however_they_are_given(tmp_path):
    nested, deep = (write_run(tmp_path / name, TABLETOP, "fbrl", rising(1, 1)) for name in ("a/b", "a/c/d"))
    (nested / "checkpoints").mkdir()
    (nested / "checkpoints" / "config.json").write_text("{}")
    assert find_runs([tmp_path, tmp_path / "a" / "c" / ".." / "b"]) == [nested, deep]
    below = write_run(deep / "e", TABLETOP, "fbrl", rising(1, 1))
    assert find_runs([deep]) == [deep], "a run that is named stands for itself alone"
    assert find_runs([tmp_path]) == [nested, deep, below]
    (tmp_path / "figure").mkdir()
    for name, target in (("first", nested), ("again", nested), ("all", tmp_path / "a")):
        (tmp_path / "figure" / name).symlink_to(target)
    assert find_runs([tmp_path / "figure"]) == [tmp_path / "figure" / "again"], (
        "links to runs are followed, each run once"
    )


def test_a_run_that_does_not_fit_is_left_out_of_its_pool(tmp_path):
    for name, seeds in (("a", (0, 1)), ("b", (1, 2)), ("other", (3, 4))):
        write_page_run(tmp_path / name, "fbrl", rising(2, 2), seeds=seeds)
    table = tmp_path / "other/metrics.csv"
    table.write_text(table.read_text().replace("continuing/reward", "renamed"))
    [run], left_out = gather([tmp_path])
    assert run.run_seeds == [0, 1, 1, 2]
    assert list(left_out) == [tmp_path / "other"]
    cause = (
        f"of {tmp_path / 'other'} and {tmp_path / 'a'}, which would be pooled, one has no column 'continuing/reward'"
    )
    assert left_out[tmp_path / "other"] == cause


def test_a_copy_is_left_out_and_a_seed_that_ran_twice_counts_once_by_its_mean(tmp_path):
    run, other = (
        write_run(tmp_path / name, TABLETOP, "naive", scores)
        for name, scores in (("a", rising(2, 3)), ("b", rising(2, 3) / 2))
    )
    write_run(tmp_path / "d", TABLETOP, "naive", constant(0.3)[:, [0, 1, 1]], seeds=(7,))
    copy = shutil.copytree(run, tmp_path / "c")
    with (
        pytest.warns(RunWarning, match=r"left out: .*c has the same numbers of seed 0 as .*a; a seed counts once"),
        pytest.warns(RunWarning, match=r"a and \S*b have seed 0, 1; each counts once, by the mean of its runs"),
    ):
        [curves] = read_all([tmp_path])
    assert [folder.path for folder in curves.runs] == [run, other, tmp_path / "d"]
    means = [*rising(2, 3) * 0.75, [0.3] * 3]
    np.testing.assert_allclose(curves.metrics["deployed/success"], means)
    with pytest.raises(ValueError, match=r"a/metrics\.csv has no column 'none'"):
        curves.metrics["none"]
    with pytest.raises(ValueError, match="a seed counts once: leave one of them out"):
        read_all([run, copy])


@pytest.mark.parametrize(("shorter", "longer"), ["ac", "ca"])
def test_of_a_run_and_a_copy_of_its_beginning_the_longer_one_is_kept_and_runs_keep_their_order(
    tmp_path, shorter, longer
):
    write_run(tmp_path / "b", TABLETOP, "fbrl", constant(0.1, 0.2))
    for name, end in ((shorter, 2), (longer, 3)):
        write_run(tmp_path / name, TABLETOP, "naive", rising(2, 3)[:, :end])
    with pytest.warns(RunWarning, match=rf"/{shorter} has the same numbers of seed 0 as \S*/{longer}; a seed counts"):
        runs = read_all([tmp_path])
    assert [(run.algo, run.length) for run in runs] == [("naive", 30), ("fbrl", 20)]


def test_seeds_of_a_run_that_repeats_others_with_the_same_numbers_are_pooled(tmp_path):
    scores = rising(3, 3)
    paths = [write_run(tmp_path / str(n), TABLETOP, "naive", scores[n : n + 2], seeds=(n, n + 1)) for n in (0, 1)]
    np.testing.assert_array_equal(read_all(paths)[0].metrics["deployed/success"], scores)


def test_at_most_five_causes_are_given_where_no_run_can_be_used(tmp_path):
    for number in range(7):
        write_run(tmp_path / str(number), TABLETOP, "naive", rising(1, 1), seeds=(number,))
    with pytest.raises(ValueError, match=r"no column 'speed'.*\n.*4/metrics\.csv .*\n  and 2 more$") as caught:
        read_methods([tmp_path], metric="speed")
    assert len(str(caught.value).splitlines()) == 7
