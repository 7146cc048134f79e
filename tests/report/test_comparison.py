"""Comparisons of runs written by hand."""

import math
import warnings

import numpy as np
import pytest
from matplotlib.image import imread

from earl_jax.metrics.scores import Window
from earl_jax.report.best import best, best_text
from earl_jax.report.comparison import compare, table_text, write_comparison
from earl_jax.runs.files import RunWarning
from tests.report.run_files import DOOR, KITCHEN, TABLETOP, constant, count_pixels, read_csv, write_run

BAD, GOOD = (0.0, 0.1, 0.0, 0.1, 0.05), (0.9, 1.0, 0.95, 0.9, 1.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two methods that differ on tabletop, one of which ran longer, and one method of another task."""
    root = tmp_path_factory.mktemp("compare")
    longer = np.hstack([constant(*GOOD), constant(0.0, 0.0, 0.0, 0.0, 0.0)])
    return [
        write_run(root / "naive", TABLETOP, "naive", constant(*BAD)),
        write_run(root / "fbrl", TABLETOP, "fbrl", longer),
        write_run(root / "door", DOOR, "fbrl", constant(*GOOD)),
    ]


def test_methods_are_compared_at_the_last_step_that_both_have(folders):
    [row] = compare(folders)
    assert (row["env"], row["first"], row["second"], row["steps"]) == (TABLETOP, "naive", "fbrl", 20)
    assert row["difference"] == pytest.approx(np.mean(BAD) - np.mean(GOOD))
    assert row["low"] < row["difference"] < row["high"] < 0
    assert row["p"] == row["p_holm"] == pytest.approx(2 / 252)
    assert row["verdict"] == "below"
    assert 0 < row["detectable"] < abs(row["difference"])


def test_scores_are_means_over_the_same_steps_however_often_their_runs_were_evaluated(tmp_path):
    """The same curve used to score more with more evaluations, since five of them were its last tenth."""
    for name, algo, every in (("a", "naive", 10), ("b", "fbrl", 2), ("c", "oracle", 4), ("d", "oracle", 10)):
        steps = range(every, 101, every)
        write_run(tmp_path / name, TABLETOP, algo, np.outer([1, 1], steps) / 100, steps, [ord(name), ord(name) + 10])
    rows = compare([tmp_path])
    assert [f"{row['first']} {row['second']}" for row in rows] == ["naive fbrl", "naive oracle", "fbrl oracle"]
    assert {round(row[name], 9) for row in rows for name in ("mean", "other_mean")} == {0.8}
    assert {round(row["score"], 9) for row in best([tmp_path])} == {0.8}
    assert "at least 5 or the evaluations of the last 44 steps" in best_text(best([tmp_path]))
    last = compare([tmp_path / "a", tmp_path / "b"], window=Window(last=3))
    assert [(row["mean"], row["other_mean"]) for row in last] == [(pytest.approx(0.9), pytest.approx(0.9))]
    write_run(tmp_path / "rare" / "e", TABLETOP, "risc", np.outer([1, 1], range(3, 100, 3)) / 100, range(3, 100, 3))
    [row] = compare([tmp_path / "a", tmp_path / "rare"])
    assert (row["steps"], row["mean"], row["other_mean"]) == (90, pytest.approx(0.7), pytest.approx(0.69))


def test_a_pair_without_a_common_step_is_left_out_with_a_warning(folders, tmp_path):
    late = write_run(tmp_path / "late", TABLETOP, "r3l", constant(*GOOD), steps=[30, 60])
    message = f"naive and r3l on {TABLETOP} are not compared: one ends before the other's first evaluation"
    with pytest.warns(RunWarning, match=message):
        rows = compare([*folders, late])
    assert [(row["first"], row["second"]) for row in rows] == [("naive", "fbrl"), ("fbrl", "r3l")]


def test_p_is_adjusted_for_all_comparisons_of_a_task(folders, tmp_path):
    more = [write_run(tmp_path / name, TABLETOP, name, constant(*BAD)) for name in ("r3l", "oracle")]
    rows = compare([*folders, *more, write_run(tmp_path / "door", DOOR, "naive", constant(*BAD))])
    assert [row["env"] for row in rows] == [TABLETOP] * 6 + [DOOR]
    assert rows.pop()["p_holm"] == pytest.approx(2 / 252), "another task is another family"
    assert max(row["p_holm"] for row in rows) == 1.0
    assert min(row["p_holm"] for row in rows) == pytest.approx(6 * 2 / 252)


def test_runs_are_compared_with_the_released_ones_from_their_first_evaluation_on(folders):
    rows = compare(folders, against="published")
    assert len(rows) == 3, "before the first released evaluation there is nothing to compare"
    verdict = "not compared before step 20,000, the first evaluation of the released runs"
    assert {row["verdict"] for row in rows} == {verdict}
    assert all(math.isnan(row["p"]) for row in rows)


def test_what_cannot_be_compared_is_refused(folders, tmp_path):
    with pytest.raises(ValueError, match="nothing to compare; compare needs runs of two methods on one task"):
        compare(folders[::2])
    dense, sparse = (
        write_run(tmp_path / algo, KITCHEN, algo, constant(1.0), env_options={"reward_type": reward})
        for algo, reward in (("naive", "dense"), ("fbrl", "sparse"))
    )
    with pytest.warns(RunWarning, match="naive and fbrl .* are not compared: one is scored by success"):
        rows = compare([*folders[:2], dense, sparse])
    assert [(row["first"], row["second"]) for row in rows] == [("naive", "fbrl")]
    shipped = write_run(tmp_path / "medal", TABLETOP, "medal", constant(*GOOD))
    for folder, cause in ((sparse, "its task, its kind of reward or its setting"), (shipped, "the paper has no medal")):
        with (
            pytest.warns(RunWarning, match=f"is not compared: {cause}"),
            pytest.raises(
                ValueError, match="nothing to compare; compare needs runs of a task and a method of the paper"
            ),
        ):
            compare([folder], against="published")
    with pytest.raises(ValueError, match="unknown against 'publised'; did you mean 'published'"):
        compare(folders, against="publised")


def test_a_comparison_is_written_as_tables_and_a_figure_with_wrapped_names(folders, tmp_path):
    rows = compare(folders)
    assert "| naive, 5 seeds | fbrl, 5 seeds |" in table_text(rows)
    assert read_csv(write_comparison(rows, tmp_path / "a.csv"))[0]["verdict"] == "below"
    assert "adjusted by Holm" in write_comparison(rows, tmp_path / "a.md").read_text()
    assert "the five released ones" not in (tmp_path / "a.md").read_text()
    tex = write_comparison(rows, tmp_path / "a.tex").read_text()
    assert tex.startswith("% The score of a seed is its mean over the evaluations")
    assert r"tabletop\_organization & naive, 5 seeds & fbrl, 5 seeds" in tex
    rows[0]["first"] += " (demo_file=$^$, discount=0.95, learning_rate=0.001, timeout_bootstrap=True, utd=20)"
    with warnings.catch_warnings(action="error"):  # of names that leave no room
        assert count_pixels(write_comparison(rows, tmp_path / "a.png"), "#1f77b4") > 50
    with pytest.raises(ValueError, match=r"comparisons are written as \.md, \.tex"):
        write_comparison(rows, tmp_path / "a.html")
    few = {"naive": (1203.0, 1401.0), "fbrl": (2203.0, 1901.0)}
    rows = compare([write_run(tmp_path / algo, KITCHEN, algo, constant(*scores)) for algo, scores in few.items()])
    assert "| 1,302 | 2,052 | -750 |" in table_text(rows)
    with pytest.raises(ValueError, match="no difference has an interval to draw: each side needs three seeds"):
        write_comparison(rows, tmp_path / "b.png")


def test_a_picture_is_as_high_as_its_longest_panel(folders, tmp_path):
    one = write_comparison(compare(folders[:2]), tmp_path / "one.png")
    other = write_run(tmp_path / "other", DOOR, "naive", constant(*BAD))
    two = write_comparison(compare([*folders, other]), tmp_path / "two.png")
    alone = write_run(tmp_path / "alone", DOOR, "r3l", constant(0.5))
    with pytest.warns(RunWarning, match="2 differences without an interval: not in the picture"):
        write_comparison(compare([*folders, other, alone]), tmp_path / "two.png")
    assert [imread(two).shape[axis] / imread(one).shape[axis] for axis in (0, 1)] == [1, 2]


def test_another_metric_is_compared_by_its_name(tmp_path):
    wide = {algo: {"deployed/success_wide": constant(*own)} for algo, own in (("naive", GOOD), ("fbrl", BAD))}
    paths = [write_run(tmp_path / algo, TABLETOP, algo, constant(*BAD), metrics=own) for algo, own in wide.items()]
    assert compare(paths)[0]["difference"] == 0
    [row] = compare(paths, metric="deployed/success_wide")
    assert row["difference"] == pytest.approx(np.mean(GOOD) - np.mean(BAD))
    with (
        pytest.warns(RunWarning, match="naive on .* is not compared: the released runs have no deployed/success_wide"),
        pytest.raises(ValueError, match="needs runs of a task and a method of the paper"),
    ):
        compare(paths, "published", metric="deployed/success_wide")
