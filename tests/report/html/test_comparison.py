"""The page of a comparison: every cell of the table, intervals on one scale, and no text that runs."""

import re

import pytest

from earl_jax.report.comparison import HEADER, cells, compare
from earl_jax.report.html import comparison
from tests.cli.process import run
from tests.report.run_files import DOOR, TABLETOP, constant, write_run

pytest.importorskip("jinja2", reason="pages need the extra 'report'")


@pytest.fixture
def folders(tmp_path):
    write_run(tmp_path / "a", TABLETOP, "naive", constant(0.1, 0.2, 0.1, 0.2, 0.15))
    write_run(tmp_path / "b", TABLETOP, "fbrl", constant(0.9, 0.8, 0.9, 0.8, 0.85))
    write_run(tmp_path / "c", DOOR, "naive", constant(0.5), env_options={"demo_file": "<script>"})
    write_run(tmp_path / "d", DOOR, "fbrl", constant(0.5, 0.6))
    write_run(tmp_path / "e", DOOR, "oracle", constant(0.6, 0.7))
    return [tmp_path / name for name in "abcde"]


def test_the_page_has_every_cell_and_draws_the_intervals(folders, tmp_path):
    out = tmp_path / "page.html"
    code, _, err = run("compare", *folders, "--out", out)
    assert (code, err) == (0, "")
    page, rows = out.read_text(), compare(folders)
    assert all(cell in page for line in cells(rows) for cell in line)
    assert all(name in page for name in HEADER[1:])
    assert page.count("<svg") == 2  # a single seed has no interval
    assert page.count('class="clear"') == 2  # the line and the mark of the only difference that can be told
    assert "<script" not in page
    assert f"earl-jax compare {folders[0]}" in page
    [low, high] = re.search(r'<line class="clear" x1="([\d.]+)" x2="([\d.]+)"', page).groups()
    [zero] = re.search(r'<line class="zero" x1="([\d.]+)"', page).groups()
    [middle] = re.search(r'<circle class="clear" cx="([\d.]+)"', page).groups()
    assert float(low) < float(middle) < float(high) < float(zero) == comparison.WIDTH - comparison.MARGIN
    width = comparison.WIDTH - 2 * comparison.MARGIN
    row = rows[0]
    assert float(zero) - float(middle) == pytest.approx(width * row["difference"] / row["low"], abs=0.2)
    assert f"replaced {out}" in run("compare", *folders, "--out", out)[2]
