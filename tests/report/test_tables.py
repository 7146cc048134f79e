"""Tables of run folders, on curves written by hand."""

import numpy as np
import pytest

from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.life import BACK, STILL
from earl_jax.protocol import Continuing
from earl_jax.report import tables
from tests.cli.process import run
from tests.report.run_files import TABLETOP, read_csv, write_run

REWARDS = {"continuing/reward": 0.0, "continuing/recent": 0.0}


def write_three_evaluations(path, seeds=(0, 1), **options):
    """Write a run whose seeds score 0, 0.5, 1 and more, and whose reward per step rises to 0.02."""
    success = np.array([0.0, 0.5, 1.0]) + 0.1 * np.arange(len(seeds))[:, None]
    recent = np.array([0.0, 0.01, 0.02])
    metrics = {"continuing/reward": np.cumsum(recent) / np.arange(1, 4), "continuing/recent": recent}
    return write_run(path, TABLETOP, "naive", success, seeds=seeds, metrics=metrics, **options)


def test_a_row_summarises_the_curves(tmp_path):
    row = tables.tabulate([write_three_evaluations(tmp_path / "a")])[0]
    assert row["deployed"] == pytest.approx(1.05)
    assert row["continuing"] == pytest.approx(0.01)
    assert row["seeds"] == 2
    assert row["steps"] == 30
    assert row["published_deployed"] == "0.32 (0.17)"
    assert row["steps_per_reward"] == pytest.approx(1 / 0.02)
    assert tables.tabulate([tmp_path / "a"], last=3)[0]["deployed"] == pytest.approx(0.55)


def test_averaging_no_evaluation_is_refused(tmp_path):
    with pytest.raises(ValueError, match="last must be at least 1, not 0"):
        tables.tabulate([tmp_path], last=0)


def test_runs_in_the_continuing_setting_have_no_published_scores(tmp_path):
    write_three_evaluations(tmp_path / "a")
    write_three_evaluations(tmp_path / "b", setting=Continuing(goal_change=7))
    deployment, continuing = tables.tabulate([tmp_path / "a", tmp_path / "b"])
    assert deployment["algo"] == "naive"
    assert deployment["published_deployed"] == "0.32 (0.17)"
    assert continuing["algo"] == "naive (goal_change=7, setting=continuing)"
    assert continuing["published_deployed"] is None
    assert continuing["options"] == "goal_change=7, setting=continuing"


def test_crossings_are_read_over_the_last_100_000_steps_with_an_interval(tmp_path):
    steps, late = list(range(20_000, 500_001, 20_000)), [[0.0] * 10 + [1.0] * 15, [0.0] * 12 + [1.0] * 13]
    [row] = tables.tabulate([write_run(tmp_path / "a", TABLETOP, "naive", late, steps=steps, metrics=REWARDS)])
    assert [row[f"steps_to_0.5{end}"] for end in ("_low", "", "_high")] == [220_000, 280_000, 340_000]
    assert "| 0.28M [0.22M, 0.34M] |" in tables.markdown([row])
    never = tables.tabulate([write_three_evaluations(tmp_path / "b")])[0]
    assert never["steps_to_0.5"] is None
    assert tables.markdown([never]).count("| - | - | 50.0 |") == 1


def test_markdown_names_the_options_in_which_runs_differ(tmp_path):
    paths = [write_three_evaluations(tmp_path / "a"), write_three_evaluations(tmp_path / "b", reward_scale=1.0)]
    text = tables.markdown(tables.tabulate(paths))
    assert "| naive |" in text
    assert "| naive (reward_scale=1.0) |" in text
    assert "naive (reward_scale=1.0): reward_scale=1.0" in text


def test_tables_are_written_as_markdown_and_csv(tmp_path):
    rows = tables.tabulate([write_three_evaluations(tmp_path / "a")])
    tables.write(rows, tmp_path / "t.csv")
    assert read_csv(tmp_path / "t.csv")[0]["published_continuing"] == "0.012 (0.004)"
    tables.write(rows, tmp_path / "t.md")
    assert "| 1.050 [0.415, 1.685] | 100% |" in (tmp_path / "t.md").read_text()
    tables.write(rows, tmp_path / "t.tex")
    assert r"& 1.050 [0.415, 1.685] & 100\%" in (tmp_path / "t.tex").read_text()
    with pytest.raises(ValueError, match=r"\.md, \.tex or \.csv"):
        tables.write(rows, tmp_path / "t.txt")


def test_tables_say_how_many_seeds_have_diverged(tmp_path):
    folder = write_three_evaluations(tmp_path / "a")
    text = (folder / "metrics.csv").read_text().splitlines()
    rows = [f"{line},{'diverged' if number == 0 else int(number in (4, 6))}" for number, line in enumerate(text)]
    (folder / "metrics.csv").write_text("\n".join(rows) + "\n")
    row = tables.tabulate([folder])[0]
    assert row["diverged"] == 1
    assert f"| {row['seeds']}, 1 of {row['seeds']} diverged |" in tables.markdown([row])
    assert "diverged" not in tables.markdown(tables.tabulate([write_three_evaluations(tmp_path / "b")]))


def test_a_task_that_cannot_be_built_is_an_error_that_names_the_run(tmp_path):
    folder = write_three_evaluations(tmp_path / "a")
    (folder / "config.json").write_text((folder / "config.json").read_text().replace(TABLETOP, "maze"))
    with pytest.raises(ValueError, match=f"{folder}: unknown env 'maze'"):
        tables.tabulate([folder])


def test_columns_of_the_life_stand_beside_the_paper_s_where_a_run_has_them(tmp_path):
    old = write_three_evaluations(tmp_path / "old")
    life = {WIDE: [[0.0, 0.5, 0.25], [0.0, 0.5, 0.75]], BACK: [[np.nan, 0.5, np.nan], [np.nan, 1.0, 0.5]], STILL: 1234}
    new = write_run(tmp_path / "new", TABLETOP, "fbrl", np.ones((2, 3)), metrics={**REWARDS, **life})
    rows = tables.tabulate([new, old])
    assert rows[0]["wide"] == pytest.approx(0.5)
    assert rows[0]["wide_low"] < 0.5 < rows[0]["wide_high"]
    assert (rows[0]["back_success"], rows[0]["still_steps"], rows[0]["alive"]) == (0.5, 1234, None)
    assert {rows[1][name] for name in ("wide", "back_success", "still_steps")} == {None}
    header, _, first, second = tables.markdown(rows).splitlines()[:4]
    assert header.endswith("| wide, mean [95 %] | back | still |")
    assert first.endswith("| 0.50 | 1,234 |")
    assert second.endswith("| - | - | - |")
    assert "wide" not in tables.markdown(tables.tabulate([old]))
    assert tables.tabulate([new], last=2)[0]["back_success"] == pytest.approx(2 / 3)


def test_the_command_takes_a_metric_and_labels_and_a_folder_of_runs(tmp_path):
    write_three_evaluations(tmp_path / "runs/a")
    write_three_evaluations(tmp_path / "runs/b", reward_scale=1.0)
    arguments = ("table", tmp_path / "runs", "--metric", "continuing/recent", "--labels", "ten", "one", "--last", "2")
    code, out, _ = run(*arguments, "--out", tmp_path / "t.tex")
    assert code == 0
    assert "| env | algo | seeds | steps | continuing/recent, mean [95 %] |" in out
    assert "| tabletop_organization | one | 2 | 30 | 0.015 [0.015, 0.015] |" in out
    assert r"ten & 2 & 30 & 0.015 [0.015, 0.015] \\" in (tmp_path / "t.tex").read_text()
    assert "replaced" in run("table", tmp_path / "runs", "--out", tmp_path / "t.tex")[2]
    code, _, err = run("table", tmp_path / "runs", "--labels", "one")
    assert (code, "give one for each of: naive; naive (reward_scale=1.0)" in err) == (2, True)


HEADER = ("task", "score [95 %]", "published")
LINES = [["door", "0.5 [0.4, 0.6]", "-"], ["tabletop_organization", 1, "-"]]


def test_a_table_that_fits_is_aligned_and_has_no_empty_column():
    assert tables.shown_table(HEADER, LINES, 80).splitlines() == [
        "task                   score [95 %]",
        "door                   0.5 [0.4, 0.6]",
        "tabletop_organization  1",
    ]


def test_a_table_without_a_width_is_markdown():
    assert tables.shown_table(HEADER, LINES, None).splitlines()[2] == "| door | 0.5 [0.4, 0.6] | - |"


@pytest.mark.parametrize("width", [24, 36])
def test_a_table_that_is_too_wide_has_a_block_for_each_row(width):
    text = tables.shown_table(HEADER, LINES, width)
    assert len(text.split("\n\n")) == 2
    assert max(map(len, text.splitlines())) <= width
    assert "tabletop_organization" in text.replace("\n", "").replace(" ", "")


def test_notes_are_wrapped_to_the_width():
    assert tables.wrapped("one two\nthree", 4) == "one\ntwo\nthre\ne"
    assert tables.wrapped("one two", None) == "one two"
