"""Hostile texts stay text in reports."""

import json
import re
import shutil

from tests.cli.process import run, succeed
from tests.report.run_files import change_config, rising, write_page_run

HOSTILE = (
    "<script>alert(1)</script>", "</script><script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "'; alert(1); '", "<!--",
    "]]>", "{{ 7 * 7 }}", "{% raw %}", "${alert(1)}", "javascript:alert(1)", "\u202egnp.exe", "\u2028", "|x|y|",
    "<style>*{display:none}</style>", "&lt;script&gt;", "\\u003cscript\\u003e", "\x1b[2J", "%s%n", "<svg/onload=alert(1)>",
    "$\\frac{", "$x$ ^{_", "_x_ %{y}", "<a href='javascript:alert(1)'>link</a>", "a\nb", "\ud800", "x" * 200,
)  # fmt: skip


def runs_code(page, clean):
    """Return whether one of the texts stands in the `page` unescaped: none of its parts is in the page of a `clean` run."""
    parts = ("<script>alert", "<img src=x", "<svg/onload", "<style>*{", ">49<")
    return page.count("<script") > clean.count("<script") or any(part in page for part in parts)


def copy_of(run, path, number):
    """Return a copy of a run at `path` with a `number` in the place of its critic's losses: an equal one would be left out."""
    table = shutil.copytree(run, path) / "metrics.csv"
    rows = [line.split(",") for line in table.read_text().splitlines()]
    for row in rows[1:]:
        row[rows[0].index("critic_loss")] = str(float(number))
    table.write_text("".join(",".join(row) + "\n" for row in rows))
    return path


def write_labelled(root):
    """Return the folders of runs whose options, and so their labels, are the hostile texts."""
    return [
        write_page_run(root / f"run{number}", "naive", rising(3, 3), env_options={"demo_file": text})
        for number, text in enumerate(HOSTILE)
    ]


def test_hostile_labels_are_text_in_pictures_and_tables(tmp_path):
    labelled = write_labelled(tmp_path)
    for command, name in (("plot", "x.pdf"), ("table", "x.tex")):
        code, out, err = run(command, *labelled, "--out", tmp_path / name)
        assert (code, err) == (0, "")
    rows = [line.replace("\\|", "").count("|") for line in out.splitlines() if line.startswith("|")]
    assert len(rows) == 2 + len(HOSTILE)
    assert len(set(rows)) == 1
    assert set(out) - set(filter(str.isprintable, out)) == {"\n"}
    assert r"\$\textbackslash{}frac\{" in (tmp_path / "x.tex").read_text()


def test_hostile_texts_are_text_on_the_page(whole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folders = [shutil.copytree(whole, tmp_path / "good")]
    recorded = json.loads((whole / "config.json").read_text())["provenance"]
    for number, text in enumerate(HOSTILE):
        folders.append(copy_of(whole, tmp_path / f"runs/run{number}", number))
        hostile = dict.fromkeys(("commit", "created", "python", "device"), text)
        change_config(folders[-1], algo=text, provenance={**recorded, **hostile})
    for name, runs in (("clean", folders[:1]), ("page", folders)):
        told = succeed("report", *runs, "--out", f"{name}.html")
        assert re.fullmatch(rf"{name}\.html: \d+\.\d MB\n", told)
    page, clean = ((tmp_path / f"{name}.html").read_text() for name in ("page", "clean"))
    assert "Visited positions" in clean
    assert not runs_code(page, clean)
    assert all(runs_code(clean + text, clean) for text in HOSTILE[:3])
