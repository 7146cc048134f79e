"""The tables of a page, row by row."""

import numpy as np
import pytest

from earl_jax.report.html.curves import POINTS, banded, panels, thinned
from earl_jax.report.html.lines import gather
from earl_jax.report.html.page_tables import paper_table, seed_table
from earl_jax.report.runs import find_runs
from tests.report.run_files import constant, write_page_run


@pytest.fixture(scope="module")
def lines(folders):
    return gather(find_runs([folders]))[0]


@pytest.fixture(scope="module")
def fbrl(lines):
    return [line for line in lines if line.group.label == "fbrl"]


def test_the_paper_table_has_our_scores_beside_the_published(lines):
    rows = {row["label"]: row for row in paper_table(1, lines)["groups"][0]["rows"]}
    fbrl = rows["fbrl"]
    assert (fbrl["mean"], fbrl["size"], fbrl["published"]) == ("0.900", "3 × 300", "0.94 (0.04)")
    assert fbrl["share"] == "at 0.012 % of steps"
    assert rows["r3l"]["line"] is None


def test_the_paper_table_names_known_faults_of_published_scores(lines):
    faults = {group["env"]: group["fault"] for group in paper_table(2, lines)["groups"]}
    assert faults["tabletop_organization"] is None
    assert "counts steps twice" in faults["sawyer_door"]


def test_the_seed_table_has_the_final_values_of_every_seed(fbrl):
    table = seed_table(fbrl)
    assert table["head"][-1] == "Requested help"
    assert table["rows"][2]["texts"] == ["0.8", "0.6759", "0.008", "30", "30", "30", "30"]


def test_a_page_shows_wide_starts_and_the_life(tmp_path):
    scores = constant(0.5, 1.0)
    run = write_page_run(tmp_path / "a", "fbrl", scores)
    table = (run / "metrics.csv").read_text().splitlines()
    added = ["deployed/success_wide,continuing/back_success,continuing/alive", *["0.125,nan,1"] * 4]
    (run / "metrics.csv").write_text("".join(f"{line},{more}\n" for line, more in zip(table, added, strict=True)))
    lines = gather(find_runs([run]))[0]
    seeds = seed_table(lines)
    texts = dict(zip(seeds["head"], seeds["rows"][0]["texts"], strict=True))
    assert (texts["Deployed, from wide starts"], texts["Ways back"], texts["Lanes alive"]) == ("0.125", "–", "1")
    plots = {plot["title"]: plot for plot in panels(lines)}
    wide, back = plots["Deployed, from wide starts"], plots["Ways back"]
    assert wide["range"] == back["range"] == [-0.04, 1.04]
    assert wide["lines"][0]["plain"]["mean"] == [0.125, 0.125]
    assert back["lines"][0]["plain"]["mean"] == [None, None]


def test_long_curves_are_thinned_with_both_ends_kept():
    indices = thinned(10_000)
    assert (len(indices), indices[0], indices[-1]) == (POINTS, 0, 9_999)
    assert thinned(7).tolist() == list(range(7))


def test_a_band_needs_three_seeds_and_numbers_that_json_cannot_hold_become_null():
    assert banded(np.array([[1.0, np.nan]]))["mean"] == [1.0, None]
    assert banded(np.ones((2, 1)))["low"] is None
    assert banded(np.ones((3, 1)))["low"] == [1.0]
