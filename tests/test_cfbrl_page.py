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
