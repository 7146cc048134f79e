"""Comparisons of runs written by hand."""

import math

import numpy as np
import pytest

from earl_jax.report.comparison import compare, table_text, write_comparison
from earl_jax.report.published import published_beside
from earl_jax.report.runs import read
from tests.report.run_files import DOOR, KITCHEN, LIGHTBULB, TABLETOP, constant, count_pixels, read_csv, write_run

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


def test_p_is_adjusted_for_all_comparisons_of_a_table(folders, tmp_path):
    more = [write_run(tmp_path / name, TABLETOP, name, constant(*BAD)) for name in ("r3l", "oracle")]
    rows = compare([*folders, *more])
    assert len(rows) == 6
    assert max(row["p_holm"] for row in rows) == 1.0
    assert min(row["p_holm"] for row in rows) == pytest.approx(6 * 2 / 252)


def test_runs_that_are_shorter_than_published_are_not_compared_with_the_published_score(folders, tmp_path):
    rows = compare(folders, against="published")
    assert len(rows) == 3
    assert all(math.isnan(row["p"]) and row["verdict"].startswith("not compared at 0.0") for row in rows)
    whole = write_run(tmp_path / "a", TABLETOP, "naive", constant(*GOOD), steps=[1_250_000, 2_500_000])
    [row] = compare([whole], against="published")
    assert row["second"] == "published 0.32 (0.17)"
    assert row["difference"] == pytest.approx(0.95 - 0.32)
    assert 0.01 < row["p"] < 0.05, "the five published seeds vary too: Welch's test has hardly more than four degrees"


def test_a_task_that_is_our_reconstruction_is_not_compared_and_its_published_score_not_shown(tmp_path):
    whole = write_run(tmp_path / "a", LIGHTBULB, "oracle", 2000 + constant(*GOOD), steps=[2_500_000, 5_000_000])
    [row] = compare([whole], against="published")
    assert row["verdict"] == "not compared: the task is our reconstruction"
    assert math.isnan(row["p"])
    assert math.isnan(row["difference"])
    assert "2028" not in table_text([row])
    assert published_beside("table1", read(whole)) is None


def test_what_cannot_be_compared_is_refused(folders, tmp_path):
    with pytest.raises(ValueError, match="nothing to compare; compare needs runs of two methods on one task"):
        compare(folders[::2])
    dense, sparse = (
        write_run(tmp_path / algo, KITCHEN, algo, constant(1.0), env_options={"reward_type": reward})
        for algo, reward in (("naive", "dense"), ("fbrl", "sparse"))
    )
    with pytest.raises(
        ValueError, match=r"naive and fbrl .*on franka_kitchen have different metrics; compare them apart"
    ):
        compare([dense, sparse])
    with pytest.raises(ValueError, match="needs runs of tasks of the paper"):
        compare([sparse], against="published")


def test_a_comparison_is_written_as_tables_and_a_figure(folders, tmp_path):
    rows = compare(folders)
    assert "| naive, 5 seeds | fbrl, 5 seeds |" in table_text(rows)
    assert read_csv(write_comparison(rows, tmp_path / "a.csv"))[0]["verdict"] == "below"
    assert "adjusted by Holm" in write_comparison(rows, tmp_path / "a.md").read_text()
    tex = write_comparison(rows, tmp_path / "a.tex").read_text()
    assert tex.startswith("% Scores are means")
    assert r"tabletop\_organization & naive, 5 seeds & fbrl, 5 seeds" in tex
    assert count_pixels(write_comparison(rows, tmp_path / "a.png"), "#1f77b4") > 50
    with pytest.raises(ValueError, match=r"comparisons are written as \.md, \.tex"):
        write_comparison(rows, tmp_path / "a.html")
    single = [row | {"low": math.nan} for row in rows]
    with pytest.raises(ValueError, match="no difference with an interval to draw"):
        write_comparison(single, tmp_path / "b.png")


def test_another_metric_is_compared_by_its_name(tmp_path):
    wide = {"naive": GOOD, "fbrl": BAD, "r3l": [np.nan] * 5}
    paths = [
        write_run(tmp_path / algo, TABLETOP, algo, constant(*BAD), metrics={"deployed/success_wide": constant(*scores)})
        for algo, scores in wide.items()
    ]
    assert compare(paths[:2])[0]["difference"] == 0
    [row] = compare(paths[:2], metric="deployed/success_wide")
    assert row["difference"] == pytest.approx(np.mean(GOOD) - np.mean(BAD))
    with pytest.raises(ValueError, match="leave out --metric"):
        compare(paths, "published", metric="deployed/success_wide")
    with pytest.raises(ValueError, match="of r3l has no value at some evaluations"):
        compare(paths, metric="deployed/success_wide")
