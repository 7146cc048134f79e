"""The tables and curves of a page, row by row."""

import shutil

import numpy as np
import pytest

from benchmarks.paper import leaderboard as committed
from earl_jax.metrics.phase_stats import BACK, FORWARD
from earl_jax.metrics.scores import Window
from earl_jax.report.html.content import page_content
from earl_jax.report.html.curves import POINTS, lines_of, panels
from earl_jax.report.html.page_tables import HERE, leaderboard, paper_table, seed_table
from earl_jax.report.leaderboard import shipped_rows
from earl_jax.report.pooling import gather
from tests.report.html.conftest import read_lines
from tests.report.run_files import DOOR, TABLETOP, change_config, constant, rising, write_page_run


def cells(table):
    """Return the cells of each row of a table, by the names of their columns."""
    head = table["head"]
    return [dict(zip(head, row, strict=True)) | {"line": line, "method": label} for line, label, row in table["rows"]]


@pytest.fixture(scope="module")
def lines(folders):
    return lines_of(gather([folders])[0])


def test_the_paper_table_has_our_scores_beside_the_published(lines):
    tabletop, door = ([line for line in lines if line.curves.env == env] for env in (TABLETOP, DOOR))
    rows = {row["method"]: row for row in cells(paper_table(1, tabletop))}
    fbrl = rows["fbrl"]
    assert (fbrl["mean (s.e.)"], fbrl["seeds × steps"]) == ("0.838 (0.044)", "3 × 300")
    assert (fbrl["published"], fbrl["verdict"]) == ("0.94 (0.04)", "at 0.012 % of the steps")
    assert (rows["r3l"]["line"], rows["r3l"]["seeds × steps"], rows["r3l"]["verdict"]) == (None, "not run", "")
    tables = [paper_table(1, tabletop), paper_table(2, tabletop), paper_table(2, door)]
    assert ["known fault" in table["note"] for table in tables] == [False, True, True]


def test_the_paper_table_has_the_verdict_on_a_whole_run(tmp_path):
    scores = constant(0.9, 1.0, 0.95, 1.0, 0.9)
    run = write_page_run(tmp_path / "a", "naive", scores, steps=[1_250_000, 2_500_000])
    assert cells(paper_table(1, read_lines(run)))[0]["verdict"] == "▲ above, p = 0.0079"
    half = write_page_run(tmp_path / "b", "fbrl", scores, steps=[625_000, 1_250_000])
    rows = {row["method"]: row for row in cells(paper_table(1, read_lines(half)))}
    assert rows["fbrl"]["verdict"].endswith(", at 50 % of the steps")


def test_the_seed_table_has_the_final_values_of_every_seed(lines):
    seeds = cells(seed_table([line for line in lines if line.curves.label == "fbrl"]))
    assert (seeds[2]["seed"], seeds[2]["score (success)"]) == ("2", "0.7448")
    assert (seeds[2]["Continuing"], seeds[2]["Requested help"]) == ("0.008", "30")


def test_a_page_shows_wide_starts_and_the_life_and_shares_of_seeds_as_rates(tmp_path):
    life = {"deployed/success_wide": 0.125, FORWARD: np.nan, BACK: [0.5, np.nan], "continuing/alive": 1}
    counts = "diverged", "help/over"
    run = write_page_run(tmp_path / "a", "fbrl", constant(0.5, 1.0), extra_counts=counts, metrics=life)
    lines = read_lines(run)
    [first, _] = cells(seed_table(lines))
    assert (first["Deployed, from wide starts"], first["Return phases"], first["Lanes alive"]) == ("0.125", "–", "1")
    plots = {plot["title"]: plot for plot in panels(lines)}
    wide, back = plots["Deployed, from wide starts"], plots["Return phases"]
    for rate in (wide, back, plots["Diverged"], plots["Lifetimes over"]):
        assert rate["range"] == [-0.04, 1.04]
    assert wide["lines"][0]["plain"]["mean"] == [0.125, 0.125]
    assert (back["lines"][0]["plain"]["mean"], "Forward phases" in plots) == ([0.5, None], False), "JSON has no nan"


@pytest.mark.parametrize(("seeds", "evaluations", "drawn"), [(2, 7, 7), (3, POINTS + 50, POINTS)])
def test_long_curves_are_thinned_with_both_ends_kept_and_a_band_needs_three_seeds(tmp_path, seeds, evaluations, drawn):
    [line] = panels(read_lines(write_page_run(tmp_path, "fbrl", rising(seeds, evaluations))))[0]["lines"]
    assert (len(line["x"]), line["x"][0], line["x"][-1]) == (drawn, 10, 10 * evaluations)
    assert (line["plain"]["low"] is None) == (seeds < 3)


def test_variants_of_a_method_have_names_shades_and_dashes_of_their_own(tmp_path):
    runs = [write_page_run(tmp_path / str(scale), "fbrl", rising(1, 1), reward_scale=scale) for scale in (3.0, 20.0)]
    lines = read_lines(*runs)
    assert [line.curves.label for line in lines] == ["fbrl (reward_scale=3)", "fbrl (reward_scale=20)"]
    assert [line.dash for line in lines] == ["solid", "dash"]
    assert lines[0].light != lines[1].light


def test_a_run_stands_in_its_place_among_the_rows_that_ship(tmp_path):
    run = write_page_run(tmp_path / "run", "fbrl", constant(0.5, 0.7), layer_norm=True)
    change_config(run, provenance={"commit": "0123456789abcdef"})
    board = leaderboard(read_lines(run))
    rows = cells(board)
    assert board["left_out"] == []
    assert len(rows) == 1 + sum(row["env"] == TABLETOP for row in shipped_rows())
    [own] = [row for row in rows if row["line"]]
    assert own["method"] == "fbrl (layer_norm=True)"
    assert own["deployed [95 %]"].startswith("0.600")
    assert (own["from"], own["seeds"], own["commit"]) == (HERE, "2", "012345678")
    scores = [float(row["deployed [95 %]"].split()[0]) for row in rows]
    assert scores == sorted(scores, reverse=True)


def test_a_run_of_another_task_or_with_other_options_is_not_ranked(tmp_path):
    wide = write_page_run(tmp_path / "wide", "fbrl", constant(0.5), env_options={"wide": True})
    fish = write_page_run(tmp_path / "fish", "naive", constant(3.0), env="fish_swim")
    door = write_page_run(tmp_path / "door", "naive", constant(0.5), env=DOOR)
    text = write_page_run(tmp_path / "text", "r3l", constant(0.5), env=DOOR, env_options={"variant": "paper"})
    boards = [leaderboard(read_lines(run)) for run in (wide, fish, door, text)]
    assert [board["left_out"] for board in boards] == [["fbrl"], ["naive"], [], ["r3l"]]
    assert [board["marked"] for board in boards] == [0, 0, 1, 0]
    assert [bool(board["rows"]) for board in boards] == [True, False, True, True]
    assert [sum(bool(line) for line, _, _ in board["rows"]) for board in boards] == [0, 0, 1, 0]


def test_a_run_of_the_repository_is_shown_once(tmp_path):
    folder = next(path for path in committed.folders() if path.parts[-2:] == (DOOR, "r3l"))
    rows = cells(leaderboard(read_lines(shutil.copytree(folder, tmp_path / "copy"))))
    assert sorted(row["from"] for row in rows if row["method"].startswith("r3l")) == ["EARL, 2022", HERE]


def test_a_seed_that_ran_twice_has_one_row_and_a_note(tmp_path):
    scores = {"a": (0.9, 0.1), "b": (0.5, 0.3)}
    lines = read_lines(*(write_page_run(tmp_path / name, "fbrl", constant(*of)) for name, of in scores.items()))
    assert [cells[:2] for _, _, cells in seed_table(lines)["rows"]] == [["0", "0.7"], ["1", "0.2"]]
    content = page_content(lines)
    assert content["tasks"][0]["notes"] == ["fbrl: seed 0, 1 ran more than once and counts by the mean of its runs."]
    assert content["summary"]["Runs"] == "2, with 2 seeds and 80 steps in total"
    line = lines[0]._replace(curves=lines[0].curves._replace(window=Window(last=1)))
    assert (
        "its mean over the last evaluation or the evaluations of the last tenth"
        in page_content([line, *lines])["difference_rule"]
    )
