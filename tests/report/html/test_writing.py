"""The HTML page of runs: its parts, its safety, its errors, and how it follows runs while they train."""

import base64
import hashlib
import html
import re

import numpy as np
import pytest

from earl_jax.metrics.comparison import mean_interval
from earl_jax.metrics.scores import DEFAULT
from earl_jax.report.html import writing
from earl_jax.report.html.writing import watch_page, write_page
from earl_jax.runs.files import RunWarning
from tests.cli.process import run
from tests.report.html.conftest import EVIL, Reader
from tests.report.run_files import TABLETOP, change_config, rising, write_page_run, write_run

pytest.importorskip("jinja2", reason="reports need the extra 'report'")
pytest.importorskip("plotly", reason="reports need the extra 'report'")


@pytest.fixture(scope="module")
def page(written):
    return Reader(written.read_text(encoding="ascii"))


def test_a_page_has_all_its_parts(page, folders):
    assert {"table", "figure", "svg", "button", "details", "img"} <= set(page.tags)
    parts = (
        "Table 1", "Table 2", "Leaderboard", "Differences between these methods", "Final values of every seed", "Videos",
        "Visited positions", "Runs", "Versions", "Left out", "config.json", "Tabletop organization", "Sawyer door",
        "Requested help", "300 of 600 steps trained", "0.94 (0.04)", f"No map of fbrl: checkpoint {folders}/fbrl",
        f"earl-jax train --config {folders}/fbrl --out runs/again", f"earl-jax report {folders} --out",
        "The runs differ in python, backend, device, commit, earl-jax, jax,", f"numpy {np.__version__}, unknown",
        f"{EVIL} ", "aaaaaaaaa-dirty", "Events of the lifetime", "Notes",
    )  # fmt: skip
    assert [part for part in parts if part not in page.text] == []
    assert page.tags.index("figure") < page.tags.index("table")


def test_a_page_makes_no_network_requests_even_by_texts_of_runs(page, written):
    """A text of a run that is not escaped would be an image with a source."""
    assert page.links
    assert [link for link in page.links if not link.startswith(("#", "data:"))] == []
    assert not re.search(r"@import|url\(|https?:", page.raw["style"])
    assert not re.search(r"fetch|XMLHttp|import|https?:|\beval", page.raw["own"])
    text = written.read_text()
    assert 'http-equiv="refresh"' not in text
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]+)"', text)[1])
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    allowed = set(re.findall(r"sha256-[^']+", policy))
    scripts = (page.raw["own"].encode(), page.unpacked("plotly"))
    assert allowed == {"sha256-" + base64.b64encode(hashlib.sha256(text).digest()).decode() for text in scripts}


def test_damaged_runs_are_listed_at_the_top_and_with_their_causes(page, folders, written):
    header = written.read_text().split("</header>")[0]
    assert "3 runs could not be read and are left out" in header
    for name, cause in (("torn", "is damaged"), ("young", "has no evaluation yet"), ("alien", "metrics.csv")):
        assert name in header
        assert re.search(rf"{re.escape(str(folders / name))}.*{cause}", page.text[page.text.index("Left out") :])
    with pytest.warns(RunWarning, match=r"^left out: \S*/young has no evaluation yet$"):
        assert run("report", folders / "young", folders / "fbrl", "--out", written.parent / "b.html")[0] == 0


def test_runs_that_cannot_be_read_or_computed_cost_these_runs_only(tmp_path):
    odd = [{"options": {"precision": "fp4"}}, {"env_options": {"x": 1}}, {"env_class": "a:b"}]
    odd += [{"provenance": value} for value in (5, {"versions": 5, "created": 7})]
    for number, values in enumerate(odd):
        change_config(write_page_run(tmp_path / f"odd{number}", "fbrl", rising(1, 2), seeds=[number]), **values)
    (tmp_path / "odd0/policies.npz").write_bytes(b"x")
    write_page_run(tmp_path / "endless", "r3l", rising(2, 2), metrics={"interventions": np.inf})
    write_page_run(tmp_path / "unknown", "oracle", [[0.5, np.nan]])
    write_page_run(tmp_path / "narrow", "risc", rising(2, 2), metrics={"deployed/success_wide": np.nan})
    huge, dense = [[1e200, -1e200], [1e308, 1e308]], {"reward_type": "dense"}
    write_run(tmp_path / "huge", TABLETOP, "naive", huge, metrics={"continuing/reward": 1}, env_options=dense)
    causes = {
        "offline": {"setting": {"name": "offline"}},
        "unknown reward_type 5; choose from sparse, dense": {"reward_type": 5},
    }
    for number, values in enumerate(causes.values()):
        change_config(write_page_run(tmp_path / f"broken{number}", "fbrl", rising(2, 2)), **values)
    with pytest.warns(RunWarning) as caught, np.errstate(all="ignore"):
        page = write_page([tmp_path], str(tmp_path / "page.html"), reload_seconds=30.0).read_text()
    text = Reader(page).text
    messages = [str(warning.message) for warning in caught]
    for name, metric, step in (("endless", "interventions", 10), ("unknown", "deployed/success", 20)):
        assert f"left out: {tmp_path}/{name}: {metric} of seed 0 at step {step} is not finite" in messages
    assert "6, with 7 seeds" in text
    assert f"{tmp_path}/odd0/policies.npz is damaged" in text
    assert f"left out: {tmp_path}/narrow: deployed/success_wide of risc has no value" in "\n".join(messages)
    assert "5 runs could not be read" in text
    assert [cause for cause in causes if cause not in text] == []
    assert '<meta http-equiv="refresh" content="30.0">' in page


def test_errors_name_the_cause_and_write_nothing(tmp_path, folders):
    out = tmp_path / "a.html"
    with pytest.raises(ValueError, match=r"none of the runs can be used:\n.*torn.*damaged.*\n.*young"):
        write_page([folders / "torn", folders / "young"], out)
    assert list(tmp_path.iterdir()) == []


def test_plots_have_means_bands_seeds_and_published_values(page):
    task = page.numbers()["t0"]
    curves = {curve["label"]: curve for curve in task["panels"][0]["lines"]}
    fbrl = curves["fbrl"]
    assert fbrl["x"] == list(range(10, 301, 10))
    assert fbrl["plain"]["mean"][-1] == 0.9
    assert [seed[-1] for seed in fbrl["plain"]["each"]] == [1.0, 0.9, 0.8]
    assert fbrl["plain"]["low"][-1] == pytest.approx(mean_interval(np.array([1.0, 0.9, 0.8]), rate=True).low, abs=1e-4)
    assert fbrl["smooth"]["mean"][-1] == pytest.approx(0.9 * (1 - 4.5 / 29), abs=1e-4)
    assert fbrl["published"]["final"][0] == 0.94
    assert fbrl["published"]["crossings"] == [[880_000, 0.5], [2_090_000, 0.9]]
    without_band = [label for label, curve in curves.items() if curve["plain"]["low"] is None]
    assert without_band == [f"naive (demo_file={EVIL})"]


@pytest.fixture
def pages(monkeypatch):
    """The numbers of runs and the reloading times of the pages that are written; a page is a text."""
    written = []

    def write(folders, out, reload_seconds=None, policies=None, window=DEFAULT):
        written.append((len(writing.gather(folders)[0]), reload_seconds))
        out.write_text("page")

    monkeypatch.setattr(writing, "write_page", write)
    return written


def watch(folder, out, *steps, every=2.0):
    """Return what `watch_page` emits while each of `steps` happens in a pause, until Ctrl-C."""
    lines, actions = [], iter(steps)

    def sleep(seconds):
        assert seconds == every
        action = next(actions, None)
        if action is None:
            raise KeyboardInterrupt
        action()

    watch_page([folder], out, every, lines.append, sleep)
    return lines


def test_a_page_is_written_when_a_run_changes_and_once_more_at_the_end(tmp_path, pages):
    folder, out = tmp_path / "sweep", tmp_path / "page.html"
    table = folder / "a" / "metrics.csv"
    steps = [
        lambda: None,
        lambda: write_page_run(folder / "a", "fbrl", rising(2, 3)).joinpath("metrics.csv").rename(tmp_path / "later"),
        lambda: (tmp_path / "later").rename(table),
        lambda: None,
        lambda: write_page_run(folder / "b", "naive", rising(2, 3)),
        lambda: table.touch(),
        lambda: table.with_name("video.gif").write_bytes(b"GIF89a"),
        lambda: table.with_name("broken.mp4").symlink_to("nowhere"),
    ]
    lines = watch(folder, out, *steps)
    assert pages == [(1, 2.0), (2, 2.0), (2, 2.0), (2, 2.0), (2, None)]
    assert lines[:2] == [f"waiting: {folder} is not a folder", f"waiting: {folder / 'a'} has no evaluation yet"]
    assert lines[2].startswith(f"{out}: written at ")
    assert lines[-1].endswith("does not reload any more")
    assert len(lines) == 7


def test_a_page_that_cannot_be_watched_is_an_error_at_once(tmp_path, pages):
    with pytest.raises(ValueError, match=r"page\.pdf: a report is written as an \.html file"):
        watch(tmp_path, tmp_path / "page.pdf")
    assert "every must be at least 1 second, not 0.1" in run("report", tmp_path, "--watch", "--every", "0.1")[2]
