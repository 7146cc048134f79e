"""One self-contained HTML page about run folders: curves, tables, seeds, maps, videos, and the origin of all of it."""

import base64
import datetime
import gzip
import hashlib
import json
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.errors import InputError, optional
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.scores import DEFAULT, Window
from earl_jax.options.values import counted
from earl_jax.report.html.content import page_content
from earl_jax.report.html.curves import lines_of
from earl_jax.report.html.media import KINDS, PolicyVideos
from earl_jax.report.pooling import find_runs, gather
from earl_jax.report.runs import Curves
from earl_jax.report.scores import row_of, seed_scores
from earl_jax.runs.contents import FILES
from earl_jax.runs.files import warn, written

TEMPLATES = Path(__file__).parent / "templates"
LEAST_SECONDS = 1.0
"""Shortest pause between two looks at the runs of a watched page."""


def write_page(
    folders: Sequence[str | Path],
    out: str | Path,
    reload_seconds: float | None = None,
    policies: PolicyVideos | None = None,
    window: Window = DEFAULT,
) -> Path:
    """Write the page of the runs in and below `folders` to `out`, an .html file, and return the path.

    Runs that cannot be read are listed on the page with the cause, and a `RunWarning` names them. With
    `reload_seconds`, a browser reloads the page at that interval. With `policies`, the page contains a video of a
    policy of each run. `window` selects the evaluations that score a run.

    Raises:
        ValueError: `out` is not an .html file, a folder contains no run, no run can be read, or a library is missing.
    """
    out = Path(out)
    environment, plotly = _libraries(out)
    runs, left_out = gather(folders, window, _check)
    for cause in left_out.values():
        warn(f"left out: {cause}")
    content = page_content(lines_of(runs), policies)
    plots = {
        task["id"]: {"panels": task["panels"], "maps": [visit_map["plot"] for visit_map in task["maps"]]}
        for task in content["tasks"]
    }
    script, style = ((TEMPLATES / f"report.{kind}").read_text() for kind in ("js", "css"))
    digests = [hashlib.sha256(text.encode()).digest() for text in (script, plotly)]
    command = ["earl-jax", "report", *map(str, folders), "--out", str(out), *(["--videos"] if policies else [])]
    command += [f"--{name}={value}" for name, value in (("last", window.last), ("window", window.steps)) if value]
    page = environment.get_template("report.html").render(
        content,
        left_out=left_out,
        reload_seconds=reload_seconds,
        command=shlex.join(command),
        style=style,
        script=script,
        plotly=_packed(plotly),
        numbers=_packed(json.dumps(plots, allow_nan=False)),
        hashes=" ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests),
    )
    return written(out, page.encode("ascii", "xmlcharrefreplace").decode())


def _check(curves: Curves) -> None:
    """Raise an error if a number of the page cannot be computed from `curves`."""
    row_of(curves)
    if WIDE in curves.metrics:
        seed_scores(curves, metric=WIDE)
    for metric in (curves.deployed_metric, "interventions"):
        wrong = np.argwhere(~np.isfinite(curves.metrics.get(metric, np.zeros((1, 1)))))
        if len(wrong):
            seed, step = curves.run_seeds[wrong[0][0]], curves.steps[wrong[0][1]]
            raise InputError(f"{metric} of seed {seed} at step {step} is not finite")


def _libraries(out: Path) -> tuple[Any, str]:
    """Return the environment of templates and plotly.js, with which a page can be written to `out`. Errors as `write_page`."""
    if out.suffix != ".html" or out.is_dir():
        raise InputError(f"{out}: a report is written as an .html file")
    jinja2, plotly = (optional(module, "reports need", "report") for module in ("jinja2", "plotly.offline"))
    loader = jinja2.FileSystemLoader(TEMPLATES)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["plural"] = counted
    return environment, plotly.get_plotlyjs()


def _packed(text: str) -> str:
    """Return `text` compressed and in base64; the page's script unpacks it."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def watch_page(
    folders: Sequence[str | Path],
    out: Path,
    every: float,
    emit: Callable[[str], None],
    sleep: Callable[[float], None] = time.sleep,
    policies: PolicyVideos | None = None,
    window: Window = DEFAULT,
) -> None:
    """Write the page of `folders` to `out` again whenever a run changes, checked every `every` seconds, until Ctrl-C.

    In a browser the page reloads itself at the same interval. It is never half written. After Ctrl-C it is written once
    more, without reloading. If no run can be read yet, the function waits. With `policies`, the page has videos of
    policies.

    Raises:
        ValueError: `every` is under a second, `out` is not an .html file, or a library is missing.
    """
    if not every >= LEAST_SECONDS:
        raise InputError(f"every must be at least {LEAST_SECONDS:g} second, not {every}")
    _libraries(out)
    seen, cause, shown = None, "", False
    try:
        while True:
            files = set(_files(folders))
            if files != seen:
                try:
                    write_page(folders, out, every, policies, window)
                    cause, shown = "", True
                    emit(f"{out}: written at {_now()}; Ctrl-C ends")
                except InputError as error:
                    if str(error) != cause:
                        emit(f"waiting: {error}")
                    cause = str(error)
            seen = files
            sleep(every)
    except KeyboardInterrupt:
        if shown:
            write_page(folders, out, policies=policies, window=window)
            emit(f"{out} is of {_now()} and does not reload any more")


def _files(folders: Sequence[str | Path]) -> Iterator[tuple[Path, int, int]]:
    """Yield path, size and time of each file that a page shows; a change of any means that the page is out of date."""
    for folder in folders:
        try:
            runs = find_runs([folder])
        except InputError:  # no run is there yet
            continue
        for run in runs:
            for path in run.iterdir():
                if (path.name in FILES or path.suffix.lower() in KINDS) and path.exists():
                    status = path.stat()
                    yield path, status.st_size, status.st_mtime_ns


def _now() -> str:
    return f"{datetime.datetime.now(datetime.UTC):%H:%M:%S} UTC"
