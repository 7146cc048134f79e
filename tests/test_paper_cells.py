"""The table of the paper's 27 cells is that of the runs, and names runs with former defaults."""

import json

from benchmarks import paper_cells
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
