"""The tables of docs/cfbrl.md follow from the runs, and a window leaves out evaluations without a phase that ended."""

import numpy as np

from benchmarks import cfbrl
from earl_jax.metrics.life import FORWARD
from earl_jax.report.runs import read


def test_the_tables_in_the_docs_are_those_of_the_runs():
    page = cfbrl.PAGE.read_text()
    assert cfbrl.page_text(page) == page, "run python -m benchmarks.cfbrl"


def test_a_window_is_the_mean_of_its_evaluations_that_have_a_value():
    curves = read(cfbrl.LONG / "sawyer_door" / "cfbrl")
    values = curves.metrics[FORWARD][:, -10:]
    np.testing.assert_allclose(cfbrl.window_scores(curves, FORWARD, 100_000), np.nanmean(values, axis=1))


def test_a_goal_that_is_missed_is_said_to_be():
    line = cfbrl._goal_line(cfbrl.Goal("sawyer_door", "deployed/success", 1.01), "cfbrl")
    assert line[-1] == "no"
    assert cfbrl._goal_line(cfbrl.Goal("sawyer_door", "deployed/success", 0.99), "cfbrl")[-1] == "yes"


def test_a_run_that_is_shorter_than_its_goal_asks_meets_it_so_far():
    goal = cfbrl.Goal("sawyer_peg", "deployed/success", 0.95, window=1_000_000)
    assert cfbrl._goal_line(goal, "cfbrl-learning")[-1] == "so far"
    assert cfbrl._goal_line(goal._replace(level=1.01), "cfbrl-learning")[-1] == "no"


def test_goals_reached_are_counted_in_a_window():
    curves = read(cfbrl.LONG / "sawyer_peg" / "cfbrl-learning")
    counts = curves.metrics[cfbrl.REACHED][:, [curves.steps.tolist().index(step) for step in (70_000, 170_000)]]
    expected = (counts[:, 1] - counts[:, 0]) / 100
    np.testing.assert_allclose(cfbrl.window_scores(curves, cfbrl.REACHED, 100_000), expected)
    assert (expected > 10).all()
