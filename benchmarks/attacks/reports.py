"""Reports, tables and plots about runs with hostile names, and about one bad run among good ones."""

import functools
import json
import re
from collections.abc import Callable
from pathlib import Path

from benchmarks.attacks.case import Case, Failure, first, refused, require
from benchmarks.attacks.checkpoints import NEWEST
from benchmarks.attacks.metrics_files import DAMAGES, remove, write
from benchmarks.attacks.place import Place

SCRIPT = "<script>alert(1)</script>"
HOSTILE = (
    SCRIPT, "</script><script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "'; alert(1); '", "<!--",
    "]]>", "{{ 7 * 7 }}",
    "{% raw %}", "${alert(1)}", "javascript:alert(1)", "\u202egnp.exe", "\u2028", "a" * 5000, "|x|y|",
    "<style>*{display:none}</style>",
    "&lt;script&gt;", "\\u003cscript\\u003e", "\x1b[2J", "%s%n", "<svg/onload=alert(1)>",
)  # fmt: skip
SAFE = "a page in which the text is text, or one line"
BAD = "a page with the good run, which names the bad one and its cause"


def config(**values) -> Callable[[Path], object]:
    """Return what changes values in config.json."""

    def change(folder: Path) -> None:
        file = folder / "config.json"
        file.write_text(json.dumps({**json.loads(file.read_text()), **values}))

    return change


def text(content: str) -> Callable[[Path], object]:
    """Return what replaces config.json."""
    return lambda folder: (folder / "config.json").write_text(content)


BAD_RUNS: dict[str, Callable[[Path], object]] = {
    "unknown method": config(algo="dreamer"),
    "unknown task": config(env="maze"),
    "unknown precision": config(options={"precision": "fp4"}),
    "unknown option": config(options={"gamma": 1}),
    "option of a wrong type": config(options={"hidden_sizes": "x"}),
    "option out of range": config(options={"discount": 7}),
    "unknown setting": config(setting={"name": "x"}),
    "unknown option of the task": config(env_options={"x": 1}),
    "horizon that no integer holds": config(env_options={"train_horizon": 3_000_000_000}),
    "unknown log": config(logs=["x"]),
    "unregistered class": config(env_class="a:b"),
    "steps of text": config(steps="x"),
    "no config": lambda folder: (folder / "config.json").unlink(),
    "config of brackets": text("[" * 5000),
    "config empty": text(""),
    "config null": text("null"),
    "provenance of a wrong type": config(provenance=5),
    "provenance of null": config(provenance=None, engine=None, id=None),
    "versions of a wrong type": config(provenance={"versions": 5, "created": 7}),
    "no table": remove,
    "link for a config": lambda folder: _link(folder / "config.json"),
    **{f"table: {name}": functools.partial(write, damage=DAMAGES[name]) for name in list(DAMAGES)[::4]},
    "damaged checkpoint": lambda folder: (folder / NEWEST / "manifest.json").write_text("{"),
    "damaged policies": lambda folder: (folder / "policies.npz").write_bytes(b"x"),
}


def _link(path: Path) -> None:
    path.unlink()
    path.symlink_to("/etc/hostname")


def hostile(value: str, where: str, place: Place) -> str:
    """Report a run in whose folder name or config a hostile text stands."""
    folder = place.finished()
    if where == "folder":
        folder = folder.rename(place.path / value.replace("/", "_").replace("\0", "")[:200])
    else:
        file = folder / "config.json"
        values = json.loads(file.read_text())
        changed = {"provenance": {**values["provenance"], "commit": value, "created": value, "python": value, "device": value},
                   "engine": value, "id": value}  # fmt: skip
        file.write_text(json.dumps({**values, **changed} if where == "provenance" else {**values, where: value}))
    good = place.finished("good")
    outcome = place.run("report", folder, good, "--out", "page.html")
    if outcome.code:
        return refused(outcome)
    page = (place.path / "page.html").read_text()
    if _runs_code(page):
        raise Failure("the text is code on the page")
    return "text on the page"


def _runs_code(page: str) -> bool:
    """Return whether one of the attacks stands in the page unescaped, outside the data of its own scripts."""
    outside = re.sub(r"<script\b[^>]*>.*?</script>", "", page, flags=re.DOTALL)
    return any(part in outside for part in ("<script>alert", "<img src=x", "<svg/onload", "<style>*{", "49 *", ">49<"))


def one_bad(damage: Callable[[Path], object], command: str, place: Place) -> str:
    """Report a good run and a bad one."""
    place.finished("good")
    damage(place.finished("bad"))
    out = {"report": "page.html", "table": "table.md", "plot": "plot.png"}[command]
    outcome = place.run(command, "good", "bad", "--out", out)
    if command != "report":
        return first(lambda: refused(outcome, "bad"), lambda: _shown(place, outcome, out))
    if outcome.code == 2 and "no config.json" in outcome.err:
        return refused(outcome)
    require(outcome.code == 0 and "Traceback" not in outcome.err, outcome, "a page")
    if "bad" not in (place.path / out).read_text():
        raise Failure("the page does not name the bad run")
    return "the page shows the good run and names the bad one"


def _shown(place: Place, outcome, out: str) -> str:
    require(outcome.code == 0 and (place.path / out).stat().st_size, outcome, "an output")
    return "shown"


def cases() -> list[Case]:
    """Return hostile texts in every place, and bad runs beside a good one."""
    places = ("folder", "algo", "provenance")
    texts = [
        Case(f"{where}: {ascii(value)[1:50]}", SAFE, functools.partial(hostile, value, where))
        for number, value in enumerate(HOSTILE)
        for where in ("folder", places[1 + number % 2])
    ]
    bad = [
        Case(f"{command}: {name}", BAD if command == "report" else "an output, or one line that names the bad run",
             functools.partial(one_bad, damage, command), fast=command == "table" and number % 5 == 0)
        for number, (name, damage) in enumerate(BAD_RUNS.items())
        for command in (("report", "table") if number % 3 else ("report", "table", "plot"))
    ]  # fmt: skip
    return [*texts, *bad]
