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
    assert [row["p_holm"] for row in rows[1:]] == holm(tests, tests=3).tolist()
    assert rows[2]["least_p"] == pytest.approx(3 * 2 / math.comb(10, 5)), "of three pairs, of which the best chose two"
    assert rows[0]["score"] == pytest.approx(0.9)
    assert (rows[0]["low"], rows[0]["high"]) == mean_interval(np.array(GOOD), rate=True)[1:]


def test_a_window_of_another_kind_and_an_unknown_test_are_refused_before_any_run_is_read(tmp_path):
    with pytest.raises(InputError, match=r"must be an .*scores\.Window, such as Window\(last=5\), not 5"):
        best([tmp_path], window=5)
    with pytest.raises(InputError, match="unknown test 't'; choose from permutation, welch"):
        best([tmp_path], test="t")


FEW, LESS, NAN = [0.1] * 3, [0.0] * 3, [math.nan, *GOOD]
RANKED = [
    ({"a": FEW, "b": FEW, "c": FEW, "d": LESS}, "tied, tied, tied, cannot tell", "from the best: rank 1, 4."),
    ({"short": GOOD, "bad": BAD, "close": CLOSE}, "best, below, shorter", "Of 1 other of the same length, 0"),
    ({"bad": BAD, "dead": NAN, "good": GOOD}, "best, below, cannot tell", "cannot tell: a score is not finite"),
    ({"nan": NAN}, "cannot tell", "no other run of the same length"),
    ({"bad": BAD, "dead": NAN}, "best, cannot tell", "no other run with a finite score"),
    ({"low": [0.3] * 3, "high": [0.1 + 0.2] * 3, "d": LESS}, "tied, tied, cannot tell", "from the best: rank 1, 3."),
    (
        {f"n{n}": [n / 5, n / 5 + 0.1] for n in range(5)},
        "best" + 4 * ", cannot tell",
        "of so many permutation tests is 1.",
    ),
    ({f"n{n}": [n / 5, n / 5 + 0.1] for n in range(5)}, "best" + 4 * ", cannot tell", "from the best: rank 2 to 5."),
    ({"4": GOOD[:4], "bad": BAD[:4], "x": [0.5], "y": [0.6]}, "best, cannot tell, cannot tell, below", "two seeds"),
]
"""The scores of runs, their verdicts by rank, and a text about them."""


@pytest.mark.parametrize(("cells", "verdicts", "text"), RANKED)
def test_verdicts_and_tests_that_count_in_the_family_are_those_of_runs_with_a_p(tmp_path, cells, verdicts, text):
    rows = best([write_cells(tmp_path, **cells)])
    assert ", ".join(row["verdict"] for row in rows) == verdicts
    assert text in best_text(rows)
    tested = [row for row in rows if not math.isnan(row["p"])]
    adjusted = holm([row["p"] for row in tested], math.comb(1 + len(tested), 2))
    assert [row["p_holm"] for row in tested] == adjusted.tolist()
    assert all(row["least_p"] <= row["p_holm"] for row in tested)


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


def test_each_task_and_kind_of_reward_is_ranked_by_itself_and_a_single_run_is_best(tmp_path):
    for reward, algo in (("sparse", "naive"), ("dense", "naive"), ("dense", "fbrl")):
        write_run(tmp_path / reward / algo, TABLETOP, algo, constant(*GOOD), env_options={"reward_type": reward})
    write_run(tmp_path / "door", DOOR, "fbrl", constant(0.5))
    rows = best([tmp_path])
    assert sorted((row["env"], row["metric"], row["rank"], row["verdict"]) for row in rows) == [
        (DOOR, "deployed/success", 1, "best"), *[(TABLETOP, "deployed/return", 1, "tied")] * 2,
        (TABLETOP, "deployed/success", 1, "best"),
    ]  # fmt: skip
    assert best_text(rows).count(f"{TABLETOP}, deployed/") == 2
    assert best_text(rows).count("no other run of the same length") == 2


def test_the_text_says_what_cannot_be_told_and_whether_it_could_be(tmp_path):
    few = best([write_cells(tmp_path, good=GOOD[:2], bad=BAD[:2], close=CLOSE[:2])])
    text = best_text(few)
    assert "Of 2 others of the same length, 2 cannot be told from the best: rank 2, 3." in text
    assert "the smallest adjusted p of so many permutation tests is 1." in text
    assert "| 1 | naive (reward_scale=1) | 2 | 20 | 0.825 |" in text
    welch = best_text(best([tmp_path], "welch"), "welch")
    assert "None could be" not in welch
    assert "by Welch's test" in welch
    assert "| 3 |" not in best_text(few, top=2)
    assert "1 more are not shown" in best_text(few, top=2)
    assert max(map(len, best_text(few, width=70).splitlines())) <= 70
    with pytest.raises(ValueError, match=r"top must lie in \[1, 2147483647\], not 0"):
        best_text(few, top=0)


def test_diverged_seeds_are_counted(tmp_path):
    diverged = {"diverged": np.array([[0], [1], [1]])}
    path = write_run(tmp_path / "run", TABLETOP, "naive", constant(*GOOD[:3])[:, :2], metrics=diverged)
    assert "| 3, 2 of 3 diverged |" in best_text(best([path]))
    for command in ("show", "best"):
        assert "2 of 3 diverged" in succeed(command, path)
