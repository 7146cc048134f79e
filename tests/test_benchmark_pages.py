"""The tables of the pages follow from the kept runs, and say what was not run."""

import itertools

import numpy as np
import pytest

from benchmarks import output, redraw
from benchmarks.output import RESULTS, read_csv
from benchmarks.paper import cells, grid, pairs
from earl_jax.cli import quickstart
from earl_jax.metrics.comparison import smallest_p
from earl_jax.paper.reproduce import ARTEFACTS
from earl_jax.report.tables import millions, number_text
from tests.conftest import write_files
from tests.report.run_files import DOOR, change_config, rising, write_run
from tests.test_differences import FORMER, VARIANT
from tests.test_docs import table_rows


@pytest.mark.parametrize("module", redraw.PAGES, ids=lambda module: module.__name__.rpartition(".")[2])
def test_the_pages_are_those_of_the_kept_runs(module):
    for path, text in module.files().items():
        assert path.read_text() == text, f"run python -m {module.__name__}"


def test_a_table_goes_between_its_marks_on_every_page_and_one_without_both_is_an_error(tmp_path, monkeypatch):
    texts = {"README.md": "A <!-- x -->old<!-- end of x --> B <!-- y -->", "docs/a.md": "<!-- x --> <!-- end of x -->"}
    write_files(texts, tmp_path)
    monkeypatch.setattr(output, "ROOT", tmp_path)
    monkeypatch.setattr(output, "DOCS", tmp_path / "docs")
    pages = {path.relative_to(tmp_path).as_posix(): text for path, text in output.pages_with({"x": "new"}).items()}
    table = "<!-- x -->\n\nnew\n\n<!-- end of x -->"
    assert pages == {"README.md": f"A {table} B <!-- y -->", "docs/a.md": table}
    with pytest.raises(ValueError, match="lacks <!-- y --> or <!-- end of y -->"):
        output.pages_with({"y": "new"})
    with pytest.raises(ValueError, match="no page has the marks of z"):
        output.pages_with({"x": "new", "z": "-"})


def cell(env, algo, verdict="cannot tell", steps=1.0, mean=0.5, other=0.25):
    """Return the row of a cell that has a share of its steps."""
    row = {"env": env, "algo": algo, "seeds": 5, "steps": 1e6 * steps, "of": 1e6, "mean": mean, "other_mean": other}
    return row | {"printed": "-41.50 (3.40)", "verdict": verdict}


def test_the_grid_has_our_score_above_the_published_one_and_the_verdict_with_the_share_of_steps():
    rows = [
        cell(DOOR, "naive", "above"),
        cell(DOOR, "fbrl", steps=0.24),
        cell(DOOR, "r3l", steps=0.96),
        cell("minitaur_pen", "oracle", "not compared at 80 % of the published steps", 0.8, -2895.4),
        cell("dhand_lightbulb", "fbrl", "not compared: the task is our reconstruction", 0.044, -330.9),
        {"env": "sawyer_peg", "algo": "naive", "seeds": None},
    ]
    parts = [line.split(" | ") for line in grid.text(rows).splitlines() if "|" in line]
    lines = {task.strip("| "): cells for task, *cells in parts}
    assert lines["Sawyer door"][:2] == ["**0.50**<br>0.25<br>▲ above", "**0.50**<br>0.25<br>? at 24 %"]
    assert lines["Sawyer door"][2].endswith("?"), "its steps are 96 %"
    assert "with less than 95 % of its steps shows its share" in grid.text(rows).replace("\n", " ")
    assert lines["Minitaur pen"][-1] == "**-2,895**<br>-42<br>not compared at 80 % |"
    assert lines["DHand lightbulb"][1] == "**-331**<br>not compared at 4.4 %"
    assert lines["Sawyer peg"][0] == "not run"


def test_the_summary_of_whole_cells_keeps_success_and_return_apart():
    rows = [
        cell(DOOR, "fbrl") | {"p_holm": 0.5, "detectable": 0.26},
        cell("minitaur_pen", "naive") | {"p_holm": 1.0, "detectable": 214.2},
        cell(DOOR, "naive", "above") | {"p_holm": 0.04},
        cell("minitaur_pen", "oracle", "below") | {"p_holm": 2e-4},
        cell(DOOR, "r3l", steps=0.94),
    ]
    text = grid.summary(rows).replace("\n", " ")
    assert "differences of 0.26 to 0.26 in success and 214 to 214 in return" in text
    assert (
        "Of the others, Naive RL is above the paper on Sawyer door (p = 0.04) "
        "and Oracle RL is below the paper on Minitaur pen (p < 0.001)." in text
    )


def test_the_kept_tables_are_redrawn_from_the_kept_runs():
    """The numbers of docs/results.md, from every metrics.csv and config.json, and the maps of figure 3."""
    reports = redraw.reports()
    assert reports.keys() == {"figure2", "figure3", "tradeoff"} <= ARTEFACTS.keys()
    for name, report in reports.items():
        assert report.text(name) == (redraw.KEPT / name / f"{name}.md").read_text(), name


def test_a_cell_without_a_run_of_todays_vaprl_has_that_of_the_former_one_and_says_so(tmp_path):
    folder = tmp_path / VARIANT
    write_run(folder, DOOR, "vaprl", rising(2, 3), metrics={"critic_loss": 2.0}, **FORMER)
    change_config(folder, provenance={"commit": "f" * 40})
    runs = cells.read_runs(tmp_path)
    rows = cells.cells(runs, cells.paper_tests(runs))
    assert (len(rows), {row["verdict"] for row in rows if not row["seeds"]}) == (27, {"not run"})
    [line] = [line for line in cells.cells_text(rows).splitlines() if "f" * 9 in line]
    assert line.startswith("| sawyer_door | vaprl, former defaults | 2 |")


def quickstart_curves(name, seeds):
    """Return the steps of a kept quickstart and its success [seeds, evaluations]."""
    rows = read_csv(RESULTS / "quickstart" / name)
    curves = [[float(row["deployed/success"]) for row in rows if row["seed"] == str(seed)] for seed in range(seeds)]
    return [int(row["step"]) for row in rows if row["seed"] == "0"], np.array(curves)


def test_the_quickstart_expects_what_pairs_of_the_kept_seeds_score():
    steps, curves = quickstart_curves("five_seeds.csv", 5)
    scores = np.stack([curves[:, end - 6 : end + 1].mean(axis=1) for end, step in enumerate(steps) if step >= 160_000])
    pairs = [scores[:, list(pair)].mean(axis=1) for pair in itertools.combinations(range(5), 2)]
    assert scores[-1].round(2).tolist() == [0.64, 0.77, 0.71, 0.68, 0.64]
    other = quickstart_curves("two_seeds.csv", 2)[1][:, -7:].mean()
    ten = quickstart_curves("ten_seeds.csv", 10)[1][:, -5:].mean(axis=1)
    assert (ten.min().round(2), ten.max().round(2)) == (0.36, 0.79)
    assert (np.min(pairs).round(2), np.max(pairs).round(2), other.round(2)) == (0.53, 0.76, 0.39)
    assert (np.floor(10 * other) / 10, np.ceil(10 * np.max(pairs)) / 10) == tuple(map(float, quickstart.RANGE))


REPLAYS = [row for row in read_csv(cells.RUNS / "pairs.csv") if row["number"] in ("11", "14", "19")]
TASKS = {"tabletop": pairs.TABLETOP, "door": DOOR, "peg": pairs.PEG}
RESULTS_PAGE = output.DOCS / "results.md"


def test_the_table_of_the_released_replay_has_the_tests_of_its_runs():
    tested = table_rows(RESULTS_PAGE.read_text(), "| released replay")
    assert len(tested) == 12
    for name, *values in tested:
        task, method = name.split(", ")
        env, algo = TASKS[task], method.lower().removesuffix(" rl")
        own = [row for row in REPLAYS if (row["env"], row["metric"]) == (env, "deployed")]
        [paper] = [row for row in own if (row["first"], row["second"]) == (algo, "published")]
        [kept] = [row for row in own if (row["first"], row["second"]) == (f"{algo}/{pairs.ALL_KEPT}", algo)]
        for row, (first, second, p) in ((paper, values[:3]), (kept, values[3:])):
            scores = [float(row[name]) for name in ("mean", "other_mean")]
            assert [float(first), float(second)] == pytest.approx(scores, abs=5.1e-4), (env, algo)
            assert p == number_text(float(row["p_holm"]), ".2g", 0.001).replace("<", "< "), (env, algo)


@pytest.mark.parametrize(
    ("number", "env", "ends", "text"),
    [
        ("5, 6", DOOR, ("vaprl/no_nearest_fallback", "vaprl/no_unmet_goals"), "(p = {} and {}; 0.518"),
        ("4", pairs.PEG, ("oracle/scale_1-seeds_20_to_29",), "0.554 (p = {}; 0.612"),
        ("11", DOOR, ("naive/replay_capacity_None published",), "0.016 after 3.97M (p = {})"),
    ],
)
def test_the_results_have_the_adjusted_p_of_a_difference(number, env, ends, text):
    own = [row for row in read_csv(cells.RUNS / "pairs.csv") if (row["number"], row["env"]) == (number, env)]
    named = {f"{row['first']} {row['second']}": f"{float(row['p_holm']):.2g}" for row in own}
    adjusted = [p for end in ends for name, p in named.items() if name.endswith(end)]
    assert text.format(*adjusted) in " ".join(RESULTS_PAGE.read_text().split())


def test_the_results_have_the_lengths_of_all_runs_of_the_trade_off():
    steps = [int(row["steps"]) for row in read_csv(redraw.KEPT / "tradeoff" / "tradeoff.csv")]
    assert f"{millions(min(steps))} to {millions(max(steps))} steps" in " ".join(RESULTS_PAGE.read_text().split())


def test_the_results_name_the_test_of_a_p_that_no_permutation_of_five_seeds_has():
    page = " ".join(RESULTS_PAGE.read_text().split())
    assert f"With five seeds against five it is {smallest_p(5, 5):.2g} or more. Figures 2 and 3" in page
    assert "printed scores have Welch's test instead" in page
    assert "by Welch's t-test" in (redraw.KEPT / "figure3" / "figure3.md").read_text()
