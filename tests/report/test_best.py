"""The ranking of the runs of a sweep, on scores written by hand."""

import json
import math

import numpy as np
import pytest

from earl_jax.errors import InputError
from earl_jax.metrics.comparison import holm, mean_interval, permutation
from earl_jax.metrics.scores import Window
from earl_jax.report.best import best, best_text
from earl_jax.runs.files import RunWarning
from tests.cli.process import succeed
from tests.report.run_files import DOOR, TABLETOP, constant, write_run

GOOD, CLOSE, BAD = [0.8, 0.85, 0.9, 0.95, 1.0], [0.7, 0.8, 0.9, 0.95, 1.0], [0.0, 0.05, 0.1, 0.15, 0.2]


def write_cells(path, **scores):
    """Write a run for each reward scale, whose seeds have constant scores; a text ending in s is a shorter run."""
    for number, (name, values) in enumerate(scores.items(), 1):
        deployed = constant(*values)[:, : 1 if name.endswith("short") else 2]
        write_run(path / name, TABLETOP, "naive", deployed, planned=20, reward_scale=float(number), batch_size=32)
    return path


def test_runs_are_ranked_and_tested_against_the_best(tmp_path):
    rows = best([write_cells(tmp_path, bad=BAD, good=GOOD, close=CLOSE)])
    assert [(row["rank"], row["options"], row["verdict"]) for row in rows] == [
        (1, "batch_size=32, reward_scale=2", "best"),
        (2, "batch_size=32, reward_scale=3", "cannot tell"),
        (3, "batch_size=32, reward_scale=1", "below"),
    ]
    tests = [permutation(np.array(GOOD), np.array(other)).p for other in (CLOSE, BAD)]
    assert [row["p"] for row in rows[1:]] == tests
    assert [row["p_holm"] for row in rows[1:]] == holm(tests).tolist()
    assert rows[2]["least_p"] == pytest.approx(2 * 2 / math.comb(10, 5))
    assert rows[0]["score"] == pytest.approx(0.9)
    assert (rows[0]["low"], rows[0]["high"]) == mean_interval(np.array(GOOD), rate=True)[1:]


def test_a_window_of_another_kind_and_an_unknown_test_are_refused_before_any_run_is_read(tmp_path):
    with pytest.raises(InputError, match=r"must be a Window, such as Window\(last=5\), not 5"):
        best([tmp_path], window=5)
    with pytest.raises(InputError, match="unknown test 't'; choose from permutation, welch"):
        best([tmp_path], test="t")


def test_runs_that_share_the_highest_score_are_tied(tmp_path):
    rows = best([write_cells(tmp_path, zero=[0.0] * 3, none=[0.0] * 3, nil=[0.0] * 3, less=[-0.1] * 3)])
    assert [(row["rank"], row["verdict"]) for row in rows[:3]] == [(1, "tied")] * 3
    assert (rows[3]["rank"], rows[3]["verdict"]) == (4, "cannot tell")
    assert "Of 3 others of the same length, 3 cannot be told from the best: rank 1, 4." in best_text(rows)


def test_a_window_changes_the_ranking(tmp_path):
    """One run has the better last evaluation, the other the better mean."""
    for number, scores in enumerate(([0.9, 0.2], [0.0, 0.8]), 1):
        write_run(tmp_path / str(number), TABLETOP, "naive", [scores] * 3, reward_scale=float(number))
    leaders = [best([tmp_path], window=window)[0] for window in (Window(), Window(last=1))]
    assert [row["options"] for row in leaders] == ["reward_scale=1", "reward_scale=2"]
    assert "over the last evaluation." in best_text([leaders[1]])


def test_another_metric_changes_the_ranking(tmp_path):
    for scale, score, reward in ((1.0, 0.9, 0.1), (2.0, 0.2, 0.3)):
        metrics = {"continuing/reward": reward}
        write_run(tmp_path / str(scale), TABLETOP, "naive", constant(score), metrics=metrics, reward_scale=scale)
    rows = json.loads(succeed("best", tmp_path, "--metric", "continuing/reward", "--json"))["rows"]
    assert [(row["options"], row["score"]) for row in rows] == [("reward_scale=2", 0.3), ("reward_scale=1", 0.1)]
    assert {row["metric"] for row in rows} == {"continuing/reward"}


def test_a_run_without_a_value_of_a_metric_is_left_out_of_the_ranking(tmp_path):
    metrics = {"3": {"loss": math.inf}, "2": {}, "1": {"loss": 1.0}}
    for scale, values in metrics.items():
        write_run(tmp_path / scale, TABLETOP, "naive", constant(0.5), metrics=values, reward_scale=float(scale))
    with (
        pytest.warns(RunWarning, match=r"left out: \S*3: loss of naive has no value at some evaluations"),
        pytest.warns(RunWarning, match=r"left out: \S*2/metrics\.csv has no column 'loss'"),
    ):
        rows = best([tmp_path], metric="loss")
    assert [(row["options"], row["score"], row["verdict"]) for row in rows] == [("reward_scale=1", 1.0, "best")]
    with pytest.raises(ValueError, match="loss of naive has no value"):
        best([tmp_path / "3", tmp_path / "1"], metric="loss")


def test_runs_of_a_task_by_success_and_by_return_are_ranked_by_themselves(tmp_path):
    for reward, algo in (("sparse", "naive"), ("dense", "naive"), ("dense", "fbrl")):
        write_run(tmp_path / reward / algo, TABLETOP, algo, constant(*GOOD), env_options={"reward_type": reward})
    rows = best([tmp_path])
    assert sorted((row["metric"], row["verdict"]) for row in rows) == [
        ("deployed/return", "tied"), ("deployed/return", "tied"), ("deployed/success", "best"),
    ]  # fmt: skip
    assert best_text(rows).count(f"{TABLETOP}, deployed/") == 2


def test_a_shorter_run_comes_last_and_is_not_compared(tmp_path):
    rows = best([write_cells(tmp_path, good_short=GOOD, bad=BAD, close=CLOSE)])
    assert [row["verdict"] for row in rows] == ["best", "below", "shorter"]
    assert (rows[2]["steps"], rows[2]["score"]) == (10, pytest.approx(0.9))
    assert rows[1]["p_holm"] == rows[1]["p"]  # one comparison


def test_a_run_whose_score_is_nan_is_not_the_best(tmp_path):
    path = write_cells(tmp_path, diverged=[math.nan, *GOOD], bad=BAD, good=GOOD)
    rows = best([path])
    assert [row["verdict"] for row in rows] == ["best", "below", "cannot tell"]
    assert rows[1]["p_holm"] == rows[1]["p"], "a test without a p counts for nothing"
    assert "cannot tell: a score is not finite" in best_text(rows)
    assert best([path / "diverged"])[0]["verdict"] == "cannot tell"


def test_the_text_says_what_cannot_be_told_and_whether_it_could_be(tmp_path):
    few = best([write_cells(tmp_path, good=GOOD[:2], bad=BAD[:2], close=CLOSE[:2])])
    text = best_text(few)
    assert "Of 2 others of the same length, 2 cannot be told from the best: rank 2, 3." in text
    assert "the smallest adjusted p of so many permutation tests is 0.67" in text
    assert "| 1 | naive (reward_scale=1) | 2 | 20 | 0.825 |" in text
    welch = best_text(best([tmp_path], "welch"), "welch")
    assert "None could be" not in welch
    assert "by Welch's test" in welch
    assert "| 3 |" not in best_text(few, top=2)
    assert "1 more are not shown" in best_text(few, top=2)
    assert max(map(len, best_text(few, width=70).splitlines())) <= 70
    with pytest.raises(ValueError, match=r"top must lie in \[1, 2147483647\], not 0"):
        best_text(few, top=0)


def test_the_smallest_adjusted_p_of_many_tests_is_at_most_1(tmp_path):
    rows = best([write_cells(tmp_path, **{f"run{n}": [n / 10, n / 10 + 0.01] for n in range(5)})])
    assert {row["least_p"] for row in rows[1:]} == {1.0}
    assert "the smallest adjusted p of so many permutation tests is 1." in best_text(rows)


def test_single_seeds_are_no_tests_of_the_family(tmp_path):
    rows = best([write_cells(tmp_path, good=GOOD[:4], bad=BAD[:4], one=[0.5], two=[0.6])])
    assert [row["verdict"] for row in rows] == ["best", "cannot tell", "cannot tell", "below"]
    assert rows[3]["p_holm"] == rows[3]["least_p"] == pytest.approx(2 / math.comb(8, 4))
    assert "None could be" not in best_text(rows)


def test_tasks_are_ranked_apart_and_a_single_run_is_best(tmp_path):
    write_cells(tmp_path / "a", good=GOOD)
    write_run(tmp_path / "door", DOOR, "fbrl", constant(0.5))
    rows = best([tmp_path])
    assert [(row["env"], row["rank"], row["verdict"]) for row in rows] == [(TABLETOP, 1, "best"), (DOOR, 1, "best")]
    assert "no other run of the same length" in best_text(rows)
