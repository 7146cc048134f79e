"""The HTML page of runs: its parts, its safety, and its errors."""

import base64
import hashlib
import html
import os
import re

import numpy as np
import pytest

from earl_jax.cli.report import report
from earl_jax.report.html.lines import gather
from earl_jax.report.html.origin import origins
from earl_jax.report.html.writing import write_page
from earl_jax.report.runs import find_runs
from tests.conftest import tiny_train
from tests.report.html.conftest import EVIL
from tests.report.html.reader import Reader

pytest.importorskip("jinja2", reason="reports need the extra 'report'")
pytest.importorskip("plotly", reason="reports need the extra 'report'")


@pytest.fixture(scope="module")
def page(written):
    return Reader(written.read_text(encoding="ascii"))


def test_a_page_has_all_its_parts(page):
    assert {"table", "figure", "svg", "button", "details", "img"} <= set(page.tags)
    parts = (
        "Table 1", "Table 2", "Leaderboard",
        "Final values of every seed", "Videos", "Visited positions", "Runs", "Versions", "Left out",
        "config.json", "Tabletop organization", "Sawyer door", "Requested help",
    )  # fmt: skip
    for part in parts:
        assert part in page.text, part
    assert "earl-jax train tabletop_organization --algo fbrl --seeds 3 --steps 300" in page.text
    assert "300 of 600 steps trained" in page.text
    assert "0.94 (0.04)" in page.text
    assert "No map of fbrl: checkpoint" in page.text


def test_a_page_makes_no_network_requests(page, written):
    assert page.links
    assert [link for link in page.links if not link.startswith(("#", "data:"))] == []
    assert not re.search(r"@import|url\(|https?:", page.raw["style"])
    assert not re.search(r"fetch|XMLHttp|import|https?:|\beval", page.raw["own"])
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]+)"', written.read_text())[1])
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    allowed = set(re.findall(r"sha256-[^']+", policy))
    scripts = (page.raw["own"].encode(), page.unpacked("plotly"))
    assert allowed == {"sha256-" + base64.b64encode(hashlib.sha256(text).digest()).decode() for text in scripts}


def test_texts_of_runs_are_escaped(page, written):
    assert page.tags.count("script") == 3
    assert page.tags.count("img") == 1
    assert not [name for name in page.attributes if name.startswith("on")]
    assert page.text.count(EVIL) >= 4
    assert EVIL not in written.read_text()


def test_damaged_runs_are_listed_with_their_causes_and_affect_no_other(page, folders):
    start = page.text.index("Left out")
    assert "3 runs could not be read" in page.text
    for name, cause in (("torn", "is damaged"), ("young", "has no evaluation yet"), ("alien", "metrics.csv")):
        assert re.search(rf"{re.escape(str(folders / name))}.*{cause}", page.text[start:])
    lines, left_out = gather(find_runs([folders]))
    assert len(lines) == 4
    assert len(left_out) == 3


def test_errors_name_the_cause_and_write_nothing(tmp_path, folders):
    out = tmp_path / "a.html"
    with pytest.raises(ValueError, match=r"none of the runs can be shown:\n.*torn: .*damaged"):
        write_page([folders / "torn"], out)
    with pytest.raises(ValueError, match=r"no config\.json in it or below"):
        write_page([tmp_path], out)
    with pytest.raises(ValueError, match="missing is not a folder"):
        write_page([tmp_path / "missing"], out)
    with pytest.raises(ValueError, match="at least one"):
        write_page([], out)
    for name in ("a.htm", "a", "metrics.csv"):
        with pytest.raises(ValueError, match=r"written as an \.html file"):
            write_page([folders], tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_plots_have_means_bands_seeds_and_published_values(page):
    task = page.numbers()["t0"]
    curves = {task["styles"][curve["line"]]["label"]: curve for curve in task["panels"][0]["lines"]}
    fbrl = curves["fbrl"]
    assert fbrl["x"] == list(range(10, 301, 10))
    assert fbrl["plain"]["mean"][-1] == 0.9
    assert [seed[-1] for seed in fbrl["plain"]["each"]] == [1.0, 0.9, 0.8]
    assert fbrl["plain"]["low"][-1] == pytest.approx(0.9 - 4.3027 * 0.1 / 3**0.5, abs=1e-3)
    assert fbrl["smooth"]["mean"][-1] == pytest.approx(0.9 * (1 - 4.5 / 29), abs=1e-4)
    assert fbrl["published"]["final"][0] == 0.94
    assert fbrl["published"]["crossings"] == [[860_000, 0.5], [2_070_000, 0.9]]
    without_band = [label for label, curve in curves.items() if curve["plain"]["low"] is None]
    assert without_band == [f"naive (demo_file={EVIL})"]


def test_versions_that_differ_are_marked(folders):
    lines, _ = gather(find_runs([folders]))
    table = origins([run for line in lines for run in line.runs])
    assert [head["count"] for head in table["heads"]] == [3, 1]
    assert "jax" in table["differing"]
    assert "python" not in table["differing"]
    assert next(row["values"] for row in table["rows"] if row["name"] == "numpy") == [np.__version__, "unknown"]


def test_a_page_is_replaced_completely_or_not_at_all(folders, tmp_path, monkeypatch):
    page = tmp_path / "deep" / "page.html"
    assert write_page([folders / "door"], page) == page
    before = page.read_text()
    monkeypatch.setattr(os, "replace", lambda *_, **__: (_ for _ in ()).throw(OSError(28, "disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_page([folders / "fbrl"], page)
    assert page.read_text() == before
    assert list(page.parent.iterdir()) == [page]


@pytest.mark.slow
def test_a_trained_run_has_a_map_of_its_positions(tmp_path, capsys):
    tiny_train("fbrl", out=tmp_path / "run", steps=80)
    report((tmp_path,), tmp_path / "page.html")
    assert re.fullmatch(r".*page\.html: \d\.\d MB\n", capsys.readouterr().out)
    [visits] = Reader((tmp_path / "page.html").read_text()).numbers()["t0"]["maps"]
    assert np.sum([share or 0 for row in visits["shares"] for share in row]) == pytest.approx(1, abs=0.01)
