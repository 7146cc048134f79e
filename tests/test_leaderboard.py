"""The leaderboard follows from the run folders, and takes only runs that keep its rules."""

import shutil

import numpy as np
import pytest

from benchmarks.paper import leaderboard
from earl_jax.metrics.deployed import WIDE
from earl_jax.report.leaderboard import shipped_rows
from earl_jax.report.tables import csv_text
from tests.report.run_files import DOOR, change_config, write_page_run

SCORES = np.tile(np.linspace(0.0, 0.4, 10), (5, 1)) + 0.02 * np.arange(5)[:, None]


@pytest.fixture
def run(tmp_path):
    """A run of five seeds that keeps the rules."""
    return written(tmp_path / "run", SCORES)


def written(path, scores, algo="naive", **options):
    """Write a run that evaluates every 10,000 steps with ten episodes, and has success from wide starts."""
    steps = [10_000 * number for number in range(1, scores.shape[1] + 1)]
    folder = write_page_run(path, algo, scores, steps=steps, metrics={WIDE: 0.25}, **options)
    change(folder, eval_episodes=10)
    return folder


def change(folder, provenance=None, **values):
    change_config(folder, provenance={"commit": "0123456789abcdef", **(provenance or {})}, **values)


def test_the_rows_that_ship_are_read_as_they_were_written():
    assert csv_text(shipped_rows()) == leaderboard.ROWS.read_text()


def test_an_added_run_is_a_row_among_the_published(tmp_path, run):
    target = leaderboard.add(run, tmp_path / "results")
    assert sorted(path.name for path in target.iterdir()) == ["config.json", "metrics.csv"]
    text = leaderboard.scores_text(leaderboard.rows_of(leaderboard.entries(tmp_path / "results")))
    [row] = [line for line in text.splitlines() if "012345678" in line]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[1].startswith("0.351 [")
    assert [cells[0], *cells[2:5]] == ["naive", "0.10M", "012345678", "0.250"]
    assert " of 5 seeds</summary>" in text
    rows = text.split("### sawyer_door")[0].splitlines()
    assert rows.index(row) > next(number for number, line in enumerate(rows) if line.startswith("| RISC |"))


def test_the_row_of_a_wheels_run_has_its_release(tmp_path, run):
    change(run, provenance={"commit": None, "release": "0.1.0"})
    leaderboard.add(run, tmp_path / "results")
    rows = leaderboard.rows_of(leaderboard.entries(tmp_path / "results"))
    assert [row["commit"] for row in rows if row["source"] == "earl_jax"] == ["0.1.0"]


def test_only_differences_that_the_seeds_show_are_listed(tmp_path, run):
    root = tmp_path / "results"
    leaderboard.add(run, root)
    for name, top in (("better", 0.5), ("same", 0.001)):
        other = written(tmp_path / name, SCORES + top, layer_norm=True, reward_scale=1.0 + top)
        leaderboard.add(other, root)
    rows = leaderboard.tests(leaderboard.entries(root))
    text = leaderboard.tests_text(rows)
    assert text.startswith("1 of 2 pairs differ. For the others the seeds cannot tell (detectable on sparse tasks: 0.0")
    assert text.count("| naive (layer_norm=True, reward_scale=1.5) |") == 1
    assert "0.500 [" in text
    assert {row["question"] for row in rows} == {"runs of naive"}
    least = min(row["p"] for row in rows)
    assert min(row["p_holm"] for row in rows) == pytest.approx(2 * least)


def test_methods_are_compared_with_naive_rl_by_the_longest_run_of_each(tmp_path):
    for name, algo, scores, options in (
        ("naive", "naive", SCORES, {}),
        ("whole", "fbrl", np.hstack([SCORES + 0.5] * 2), {}),
        ("half", "fbrl", SCORES, {"layer_norm": True}),
    ):
        written(tmp_path / "leaderboard" / "tabletop_organization" / name, scores, algo, **options)
    rows = leaderboard.tests(leaderboard.entries(tmp_path))
    pairs = {(row["first"], row["second"], row["question"]) for row in rows}
    names = "fbrl (layer_norm=True)", "fbrl"
    assert pairs == {(names[1], "naive", "methods"), (*names, "runs of fbrl")}


def test_a_row_says_which_settings_were_chosen_with_a_look_at_runs_of_the_task(tmp_path):
    for number, (algo, options) in enumerate(
        [("vaprl", {}), ("vaprl", {"reward_scale": 1.0, "unmet_goals": False, "nearest_fallback": False}), ("fbrl", {}),
         ("fbrl", {"fixed_phases": True}), ("cfbrl", {})]
    ):  # fmt: skip
        written(tmp_path / "leaderboard" / DOOR / str(number), SCORES, algo, env=DOOR, **options)
    rows = [row for row in leaderboard.rows_of(leaderboard.entries(tmp_path)) if row["source"] == "earl_jax"]
    chosen = [words for _, words in sorted((row["method"].partition(" ")[0], row["chosen"]) for row in rows)]
    assert chosen == ["all options", "reward scale", "reward scale, phases", "-", "reward scale, subgoals"]


def test_runs_of_one_method_are_named_by_options_that_one_of_them_lacks(tmp_path):
    for name, options in {"default": {}, "all": {"replay_capacity": None}}.items():
        written(tmp_path / "leaderboard" / "sawyer_peg" / name, SCORES, env="sawyer_peg", **options)
    assert [group.label for group in leaderboard.entries(tmp_path)] == ["naive (replay_capacity=None)", "naive"]


def test_only_runs_with_scripted_corrections_say_so(tmp_path):
    for name, options in {"on": {}, "off": {"corrected": 0.0}}.items():
        written(tmp_path / "leaderboard" / "sawyer_peg" / name, SCORES, "cfbrl", env="sawyer_peg", **options)
    labels = [group.label for group in leaderboard.entries(tmp_path)]
    assert labels == ["cfbrl (corrected=0)", "cfbrl (scripted corrections of this task; corrected=0.5)"]


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ({"eval_episodes": 2}, "evaluations have fewer than 10 episodes"),
        ({"steps": 110_000}, "it has 100000 of 110000 steps"),
        ({"env_options": {"wide": True}}, "the task has options"),
        ({"env_options": {"demo_file": "mine.npz"}}, "it was trained with other demonstrations"),
        ({"options": {"reward_scale": [1.0, 1.0, 10.0, 10.0, 10.0]}}, "its seeds have different hyper-parameters"),
        ({"algo_class": "mine:Naive"}, "mine:Naive is not registered"),
        ({"imports": [{"file": "mine.py", "sha256": "0" * 64}]}, "it was trained with a file of its own"),
        ({"provenance": {"commit": "0123456789-dirty"}}, "012345678-dirty lacks changes"),
        ({"provenance": {"commit": None, "release": "0.1.0-dirty"}}, "0.1.0-dirty lacks changes"),
        ({"provenance": {"commit": None, "release": "0.0.9"}}, "0.0.9 is neither a commit nor in CHANGELOG.md"),
        ({"provenance": {"commit": None}}, "its config.json has neither a commit nor a release"),
    ],
)
def test_a_run_that_breaks_a_rule_is_refused(tmp_path, run, values, rule):
    change(run, **values)
    with pytest.raises(ValueError, match=f"this run cannot be added: {rule}"):
        leaderboard.add(run, tmp_path / "results")
    assert not (tmp_path / "results").exists()


def test_a_run_with_few_seeds_and_a_second_one_of_the_same_options_are_refused(tmp_path, run):
    with pytest.raises(SystemExit, match="it has 4 seeds, fewer than 5"):
        leaderboard.main(written(tmp_path / "few", SCORES[:4]))
    leaderboard.add(run, tmp_path / "results")
    copy = shutil.copytree(run, tmp_path / "copy")
    with pytest.raises(ValueError, match="has the same task, method and options"):
        leaderboard.add(copy, tmp_path / "results")
