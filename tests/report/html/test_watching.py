"""A page that follows runs: written when they change, never half, and for good after Ctrl-C."""

import pytest

from earl_jax.report.html import watching, writing
from earl_jax.runs.files import RunWarning
from tests.cli.process import run
from tests.report.run_files import TABLETOP, rising, write_page_run


@pytest.fixture
def pages(monkeypatch):
    """The folders and times of the pages that are written; a page is a text."""
    pytest.importorskip("jinja2", reason="reports need the extra 'report'")
    pytest.importorskip("plotly", reason="reports need the extra 'report'")
    written = []

    def write_page(folders, out, reload_seconds=None, policies=None):
        lines, _ = writing.gather(writing.find_runs(folders))
        if not lines:
            raise watching.InputError("none of the runs can be shown:\n  young: no evaluation yet")
        written.append((len(lines), reload_seconds))
        out.write_text("page")

    monkeypatch.setattr(watching, "write_page", write_page)
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

    watching.watch_page([folder], out, every, lines.append, sleep)
    return lines


def test_the_page_is_written_when_a_run_changes_and_once_more_at_the_end(tmp_path, pages):
    folder, out = tmp_path / "sweep", tmp_path / "page.html"
    first = folder / "a"
    steps = [
        lambda: None,
        lambda: write_page_run(first, "fbrl", rising(2, 3)),
        lambda: None,
        lambda: write_page_run(folder / "b", "naive", rising(2, 3)),
        lambda: (first / "metrics.csv").touch(),
        lambda: (first / "video.gif").write_bytes(b"GIF89a"),
        lambda: None,
    ]
    lines = watch(folder, out, *steps)
    assert pages == [(1, 2.0), (2, 2.0), (2, 2.0), (2, 2.0), (2, None)]
    assert lines[0] == f"waiting for runs in {folder}; Ctrl-C ends"
    assert lines[1].startswith(f"{out}: written at ")
    assert lines[-1].endswith("does not reload any more")
    assert len(lines) == 6


def test_a_run_without_an_evaluation_is_waited_for(tmp_path, pages):
    table = write_page_run(tmp_path / "sweep/a", "fbrl", rising(2, 3)) / "metrics.csv"
    text = table.read_text()
    table.unlink()
    lines = watch(tmp_path / "sweep", tmp_path / "p.html", lambda: None, lambda: table.write_text(text))
    assert lines[0] == "waiting: young: no evaluation yet"
    assert pages == [(1, 2.0), (1, None)]


def test_what_cannot_be_written_is_an_error_at_once(tmp_path, pages):
    with pytest.raises(ValueError, match=r"page\.pdf: a report is written as an \.html file"):
        watch(tmp_path, tmp_path / "page.pdf")
    assert "every must be at least 1 second, not 0.1" in run("report", tmp_path, "--watch", "--every", "0.1")[2]


def test_a_page_that_is_watched_reloads_itself(folders, written, tmp_path):
    text = writing.write_page([folders / "fbrl"], tmp_path / "a.html", reload_seconds=30.0).read_text()
    assert '<meta http-equiv="refresh" content="30.0">' in text
    assert 'http-equiv="refresh"' not in written.read_text()


def test_runs_that_are_left_out_are_named_at_the_top_and_by_the_command(folders, written, tmp_path):
    header = written.read_text().split("</header>")[0]
    assert "3 runs could not be read and are left out" in header
    assert all(name in header for name in ("torn", "young", "alien"))
    assert TABLETOP not in header.split("left out")[1]
    with pytest.warns(RunWarning, match=r"^left out: \S*/young has no evaluation yet$"):
        assert run("report", folders / "young", folders / "fbrl", "--out", tmp_path / "b.html")[0] == 0
