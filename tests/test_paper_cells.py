"""The tables of the pages are those of the kept runs."""

import json

import numpy as np
import pytest

from benchmarks import cfbrl, paper_cells, redraw
from earl_jax.metrics.life import FORWARD
from earl_jax.report.runs import read
from tests.report.run_files import rising, write_run


def test_a_cell_without_a_run_of_todays_vaprl_has_that_of_the_former_one_and_says_so(tmp_path):
    former = {"nearest_fallback": False, "unmet_goals": False}
    folder = tmp_path / "sawyer_door" / "vaprl" / paper_cells.FORMER_VAPRL
    losses = {"critic_loss": 2.0}
    write_run(folder, "sawyer_door", "vaprl", rising(2, 3), metrics=losses, **former)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**config, "provenance": {"commit": "f" * 40}}))
    [line] = [line for line in paper_cells.cells_text(paper_cells.cells(tmp_path)).splitlines() if "f" * 9 in line]
    assert line.startswith("| sawyer_door | vaprl, former defaults | 2 |")
    [own] = [row for row in paper_cells.cells(tmp_path) if row["seeds"]]
    assert (own["algo"], own["run"]) == ("vaprl", f"vaprl/{paper_cells.FORMER_VAPRL}")


def test_the_tables_of_cells_in_the_docs_are_those_of_the_runs():
    rows = paper_cells.cells()
    assert len(rows) == 27
    for page, table in (
        ("docs/results.md", paper_cells.cells_summary(rows)),
        ("README.md", paper_cells.tested_summary(rows)),
    ):
        text = (paper_cells.PAGES / page).read_text()
        assert paper_cells.with_table(text, table) == text, "run python -m benchmarks.paper_cells"
        assert paper_cells.with_table(text, "| another |") != text


def test_the_kept_tables_are_redrawn_from_the_kept_runs(tmp_path):
    """The numbers of docs/results.md, from every metrics.csv and config.json, and the data of figures 4 and 5."""
    tables = [path.relative_to(tmp_path) for path in redraw.redraw(tmp_path) if path.suffix == ".md"]
    assert len(tables) == 7
    for path in tables:
        assert (tmp_path / path).read_text() == (redraw.KEPT / path).read_text(), path


def test_the_tables_of_cfbrl_in_the_docs_are_those_of_the_runs():
    page = cfbrl.PAGE.read_text()
    assert cfbrl.page_text(page) == page, "run python -m benchmarks.cfbrl"


@pytest.mark.parametrize(
    ("goal", "run", "met"),
    [
        (cfbrl.Goal("sawyer_door", "deployed/success", 0.99), "cfbrl", "yes"),
        (cfbrl.Goal("sawyer_door", "deployed/success", 1.01), "cfbrl", "no"),
        (cfbrl.Goal("sawyer_peg", "deployed/success", 0.95, window=1_000_000), "cfbrl-learning", "so far"),
        (cfbrl.Goal("sawyer_peg", "deployed/success", 1.01, window=1_000_000), "cfbrl-learning", "no"),
    ],
)
def test_a_goal_is_met_missed_or_met_so_far_by_a_shorter_run(goal, run, met):
    assert cfbrl._goal_line(goal, run)[-1] == met


def test_a_window_is_the_mean_of_its_evaluations_with_a_value_or_the_goals_reached_in_it():
    curves = read(cfbrl.LONG / "sawyer_door" / "cfbrl")
    expected = np.nanmean(curves.metrics[FORWARD][:, -10:], axis=1)
    np.testing.assert_allclose(cfbrl.window_scores(curves, FORWARD, 100_000), expected)
    curves = read(cfbrl.LONG / "sawyer_peg" / "cfbrl-learning")
    counts = curves.metrics[cfbrl.REACHED][:, [curves.steps.tolist().index(step) for step in (70_000, 170_000)]]
    per_thousand = (counts[:, 1] - counts[:, 0]) / 100
    np.testing.assert_allclose(cfbrl.window_scores(curves, cfbrl.REACHED, 100_000), per_thousand)
    assert (per_thousand > 10).all()
