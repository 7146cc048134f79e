"""Tables of run folders, on curves written by hand, and tables as text."""

import numpy as np
import pytest

from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.phase_stats import ALIVE, BACK, STILL
from earl_jax.metrics.scores import SUCCESS, Window
from earl_jax.protocol import Continuing
from earl_jax.report import tables
from tests.cli.process import one_line, run, succeed, unchanged
from tests.report.run_files import DOOR, TABLETOP, constant, read_csv, write_run

REWARDS = {"continuing/reward": 0.0, "continuing/recent": 0.0}


def write_three_evaluations(path, **options):
    """Write a run of two seeds that score 0, 0.6, 0.9 and 0.1 more, and whose reward per step rises to 0.02."""
    success = np.add.outer([0.0, 0.1], [0.0, 0.6, 0.9])
    recent = np.array([0.0, 0.01, 0.02])
    metrics = {"continuing/reward": np.cumsum(recent) / np.arange(1, 4), "continuing/recent": recent}
    return write_run(path, TABLETOP, "naive", success, metrics={**metrics, **options.pop("metrics", {})}, **options)


def test_a_row_summarises_the_curves(tmp_path):
    folder = write_three_evaluations(tmp_path)
    [row] = tables.tabulate([folder])
    expected = {"deployed": 0.55, "deployed_stderr": 0.05 / np.sqrt(2), "continuing": 0.01, "continuing_stderr": 0.0}
    expected |= {"seeds": 2, "steps": 30, "steps_per_reward": 50}
    assert {name: row[name] for name in expected} == pytest.approx(expected)
    assert row["published_deployed"] == "0.32 (0.17)"
    assert row["steps_to_0.5"] is None
    text = tables.run_table([row]).text()
    assert text.count("| - | - | 50.0 |") == 1
    assert "The score of a seed is its mean over the evaluations of the last tenth of the run, at least 5." in text
    assert "seeds over 0.5: the share of seeds with such a score. steps/reward: steps for a reward of 1" in text
    assert tables.tabulate([folder], Window(last=1))[0]["deployed"] == pytest.approx(0.95)


def test_a_run_from_elsewhere_may_lack_rewards_and_a_score_that_is_not_finite_is_not_below_a_half(tmp_path):
    [row] = tables.tabulate([write_run(tmp_path / "own", TABLETOP, "naive", [[0.9, 0.9], [0.9, np.nan]])])
    assert np.isnan([row["deployed"], row["continuing"], row["continuing_stderr"]]).all()
    assert row["seeds_above_half"] is None
    halves = [[0.0, 0.6, 1.0, 0.8, 0.1], [0.5] * 5, [0.5, 0.5, 0.6, 0.5, 0.5]]
    assert tables.tabulate([write_run(tmp_path / "half", TABLETOP, "fbrl", halves)])[0]["seeds_above_half"] == 1 / 3
    assert "| naive | 2 | 20 | - | - | 0.32 (0.17) | - |" in tables.run_table([row]).text()


def test_the_rows_of_a_task_stand_together_under_their_own_names(tmp_path):
    envs = (DOOR, TABLETOP, DOOR)
    folders = [
        write_run(tmp_path / str(number), env, algo, constant(0.5), metrics=REWARDS)
        for number, (env, algo) in enumerate(zip(envs, ("naive", "fbrl", "fbrl"), strict=True))
    ]
    rows = tables.tabulate(folders, names=("first", "second", "third"))
    assert [(row["env"], row["algo"]) for row in rows] == [(TABLETOP, "second"), (DOOR, "first"), (DOOR, "third")]


@pytest.mark.parametrize(
    ("rates", "reward_type", "steps"),
    [
        ((0.02, 0.0005, 0.0004), "sparse", 2_000),
        ((0.02, 0.01, 0.0), "sparse", 100),
        ((0.02, 0.0), "sparse", None),
        ((0.02, 0.01), "dense", None),
        ((), "sparse", None),
    ],
)
def test_steps_per_reward_are_the_median_of_all_seeds_and_none_where_it_is_infinite_or_unknown(
    tmp_path, rates, reward_type, steps
):
    recent = {"continuing/recent": constant(*rates)} if rates else {}
    options = {"metrics": {"continuing/reward": 0.01, **recent}, "env_options": {"reward_type": reward_type}}
    rows = tables.tabulate([write_run(tmp_path, TABLETOP, "naive", constant(*rates or (1.0,)), **options)])
    assert rows[0]["continuing"] == 0.01
    assert rows[0]["steps_per_reward"] == (steps and pytest.approx(steps))
    assert ("| - |\n" in tables.run_table(rows).text()) == (steps is None)


@pytest.mark.parametrize(
    ("metric", "trial"), [(SUCCESS, True), (ALIVE, True), ("continuing/reward", False), (STILL, False)]
)
def test_seeds_that_agree_are_trials_of_a_rate_but_not_of_the_reward_of_a_life(tmp_path, metric, trial):
    equal = {"continuing/reward": 0.0, ALIVE: 0.0, STILL: 0.0}
    rows = tables.tabulate([write_run(tmp_path, TABLETOP, "naive", constant(0, 0, 0), metrics=equal)], metric=metric)
    assert ("| 0 |" in tables.run_table(rows).text()) == (not trial)
    assert [rows[0][end] for end in ("mean", "low", "high")] == pytest.approx(
        [0, 0, 0.5615] if trial else [0, np.nan, np.nan], abs=1e-4, nan_ok=True
    )


def test_runs_with_other_options_have_rows_notes_and_published_scores_of_their_own(tmp_path):
    settings = {"a": {}, "b": {"setting": Continuing(goal_change=7)}, "c": {"reward_scale": 1.0}}
    paths = [write_three_evaluations(tmp_path / name, **options) for name, options in settings.items()]
    rows = tables.tabulate(paths)
    assert [row["published_deployed"] for row in rows] == ["0.32 (0.17)", None, "0.32 (0.17)"]
    text = tables.run_table(rows).text()
    assert all(f"| {row['algo']} |" in text for row in rows)
    assert text.endswith("naive (reward_scale=1, setting=deployment): reward_scale=1")


def test_crossings_are_read_over_the_last_100_000_steps_with_an_interval(tmp_path):
    steps, late = list(range(20_000, 500_001, 20_000)), [[0.0] * n + [1.0] * (25 - n) for n in (10, 11, 12)]
    [row] = tables.tabulate([write_run(tmp_path, TABLETOP, "naive", late, steps=steps, metrics=REWARDS)])
    assert [row[f"steps_to_0.5{end}"] for end in ("_low", "", "_high")] == [220_000, 280_000, 340_000]
    text = tables.run_table([row]).text()
    assert "| 0.28M [0.22M, 0.34M] |" in text
    assert "to 0.5: the first step at which the mean success over 100,000 steps reaches it" in text


def test_tables_are_written_as_markdown_latex_and_csv(tmp_path):
    rows = tables.tabulate([write_three_evaluations(tmp_path / "a")])
    for suffix in ("csv", "md", "tex"):
        tables.write(rows, tmp_path / "new" / f"t.{suffix}")
    assert read_csv(tmp_path / "new/t.csv")[0]["published_continuing"] == "0.012 (0.004)"
    assert "| 0.550 | 50% |" in (tmp_path / "new/t.md").read_text()
    assert r"& 0.550 & 50\%" in (tmp_path / "new/t.tex").read_text()
    signs = tables.Table(["p", "x"], [["<0.001", "a|b > c_d"]]).latex()
    assert r"$<$0.001 & a$|$b $>$ c\_d \\" in signs, "signs that LaTeX prints as others are in mathematics"
    with pytest.raises(ValueError, match=r"tables are written as \.md, \.tex, \.csv"):
        tables.write(rows, tmp_path / "t.txt")


def test_tables_say_how_many_seeds_have_diverged(tmp_path):
    diverged = {"diverged": [[0, 0, 0], [0, 1, 1]]}
    rows = tables.tabulate([write_three_evaluations(tmp_path / "a", metrics=diverged)])
    assert rows[0]["diverged"] == 1
    assert "| 2, 1 of 2 diverged |" in tables.run_table(rows).text()
    assert "diverged" not in tables.run_table(tables.tabulate([write_three_evaluations(tmp_path / "b")])).text()


def test_columns_of_the_life_stand_beside_the_paper_s_where_a_run_has_them(tmp_path):
    old = write_three_evaluations(tmp_path / "old")
    life = {WIDE: [[0.0, 0.5, 0.25], [0.0, 0.5, 0.75]], BACK: [[np.nan, 0.5, np.nan], [np.nan, 1.0, 0.5]], STILL: 1234}
    new = write_run(tmp_path / "new", TABLETOP, "fbrl", np.ones((2, 3)), metrics={**REWARDS, **life})
    rows = tables.tabulate([new, old])
    assert rows[0]["wide"] == pytest.approx(1 / 3)
    assert np.isnan(rows[0]["wide_low"])
    assert (rows[0]["back_success"], rows[0]["still_steps"], rows[0]["alive"]) == (0.625, 1234, None)
    assert {rows[1][name] for name in ("wide", "back_success", "still_steps")} == {None}
    header, _, first, second = tables.run_table(rows).text().splitlines()[:4]
    assert header.endswith("| wide, mean [95 %] | back | still |")
    assert first.endswith("| 0.62 | 1,234 |")
    assert second.endswith("| - | - | - |")
    assert "wide" not in tables.run_table(tables.tabulate([old])).text()
    assert tables.tabulate([new], Window(last=1))[0]["back_success"] == 0.5
    with pytest.raises(ValueError, match=f"{BACK} of fbrl has no value at some evaluations"):
        tables.tabulate([new], metric=BACK)


def test_a_metric_without_a_value_before_the_window_has_a_score(tmp_path):
    late = {BACK: [[np.nan, 0.5, 1.0], [0.0, 0.5, 0.5]]}
    run_folder = write_run(tmp_path, TABLETOP, "fbrl", np.ones((2, 3)), metrics={**REWARDS, **late})
    assert tables.tabulate([run_folder], Window(last=2), metric=BACK)[0]["mean"] == 0.625


def test_the_command_takes_a_metric_and_labels_and_a_folder_of_runs(tmp_path):
    write_three_evaluations(tmp_path / "runs/a")
    write_three_evaluations(tmp_path / "runs/b", reward_scale=1.0)
    arguments = ("table", tmp_path / "runs", "--metric", "continuing/recent", "--labels", "ten", "--last", "2")
    out = succeed(*arguments, "--out", tmp_path / "t.tex", "--labels", "one")
    assert "| task | method | seeds | steps | continuing/recent, mean [95 %] |" in out
    assert "| tabletop_organization | one | 2 | 30 | 0.015 |" in out
    assert r"ten & 2 & 30 & 0.015 \\" in (tmp_path / "t.tex").read_text()
    assert "replaced" in run("table", tmp_path / "runs", "--out", tmp_path / "t.tex")[2]
    data = next(tmp_path.glob("runs/**/metrics.csv"))
    with unchanged(tmp_path / "runs"):
        assert "is a file of a run; choose another name" in run("table", tmp_path / "runs", "--out", data)[2]
    (tmp_path / "folder.md").mkdir()
    for command in (("table", tmp_path / "runs"), ("demos", "tabletop_organization")):
        one_line(run(*command, "--out", tmp_path / "folder.md"), "folder.md is a folder; choose the name of a file")
    refusal = "give one for each of: naive (reward_scale=10); naive (reward_scale=1)"
    one_line(run("table", tmp_path / "runs", "--labels", "one"), refusal)


TABLE = tables.Table(
    ("task", "score [95 %]", "published"), [["door", "0.5 [0.4, 0.6]", "-"], [TABLETOP, 1, "-"]], ["one two"]
)


def test_a_table_that_fits_is_aligned_and_has_no_empty_column():
    aligned = "task                   score [95 %]\ndoor                   0.5 [0.4, 0.6]\ntabletop_organization  1"
    assert TABLE.text(80) == f"{aligned}\n\none two"


@pytest.mark.parametrize("width", [6, 24, 36])
def test_a_table_that_is_too_wide_has_a_block_for_each_row_and_wrapped_notes(width):
    *blocks, note = TABLE.text(width).split("\n\n")
    assert len(blocks) == 2
    assert max(map(len, TABLE.text(width).splitlines())) <= width
    assert TABLETOP in blocks[1].replace("\n", "").replace(" ", "").replace("task", "")
    assert note.split() == ["one", "two"]
    assert ("\n" in note) == (width < 7)


def test_steps_are_written_in_short_without_an_exponent_and_numbers_in_three_digits_or_without_a_fraction():
    texts = {500: "500", 20_000: "20k", 999_999: "1M", 2_500_000: "2.5M", 1_234_000_000: "1.23B"}
    assert {steps: tables.steps_text(steps) for steps in texts} == texts

    numbers = [0.012345, 999.4, 999.7, -2345.6, np.nan]
    assert list(map(tables.number_text, numbers)) == ["0.0123", "999", "1,000", "-2,346", "-"]
    assert tables.interval_text(34567.8, 5.4321, 123456.7, ".4g") == "34,568 [5.432, 123,457]"
