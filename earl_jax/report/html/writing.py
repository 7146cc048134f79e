"""One self-contained HTML page about run folders: curves, tables, seeds, maps, videos, and the origin of all of it."""

import base64
import gzip
import hashlib
import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError
from earl_jax.report.html.content import page_content, plot_numbers
from earl_jax.report.html.lines import gather
from earl_jax.report.html.origin import report_command
from earl_jax.report.html.policy_videos import PolicyVideos
from earl_jax.report.runs import find_runs
from earl_jax.runs.files import RunWarning, write_atomically

TEMPLATES = Path(__file__).parent / "templates"


def write_page(
    folders: Sequence[Path], out: Path, reload_seconds: float | None = None, policies: PolicyVideos | None = None
) -> Path:
    """Write the page of the runs in and below `folders` to `out`, an .html file, and return the path.

    Runs that cannot be read are listed on the page with the cause, and named by a `RunWarning`. With `reload_seconds`, a
    browser loads the page again as often. With `policies`, a video of a policy of each run is on the page.

    Raises:
        ValueError: `out` is not an .html file, a folder holds no run, no run can be read, or a library is missing.
    """
    environment, plotly = require_writable(out)
    lines, left_out = gather(find_runs(folders))
    if not lines:
        causes = "\n".join(f"  {folder.path}: {folder.cause}" for folder in left_out)
        raise InputError(f"none of the runs can be shown:\n{causes}")
    for folder in left_out:
        name = "" if str(folder.path) in folder.cause else f"{folder.path}: "
        warnings.warn(f"left out: {name}{folder.cause}", RunWarning, stacklevel=2)
    content = page_content(lines, policies)
    script, style = ((TEMPLATES / f"report.{kind}").read_text() for kind in ("js", "css"))
    page = environment.get_template("report.html").render(
        content,
        left_out=left_out,
        reload_seconds=reload_seconds,
        report_command=report_command(folders, out, policies is not None),
        style=style,
        script=script,
        plotly=packed(plotly),
        numbers=packed(json.dumps(plot_numbers(content), allow_nan=False)),
        hashes=" ".join(f"'sha256-{_sha256(text)}'" for text in (script, plotly)),
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, page.encode("ascii", "xmlcharrefreplace").decode())
    return out


def require_writable(out: Path) -> tuple[Any, str]:
    """Return the environment of templates and plotly.js, with which a page can be written to `out`.

    Raises:
        ValueError: `out` is not an .html file, or a library is missing.
    """
    if out.suffix != ".html" or out.is_dir():
        raise InputError(f"{out}: a report is written as an .html file")
    try:
        import jinja2
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise InputError("reports need jinja2 and plotly: pip install 'earl-jax[report]'") from error
    loader = jinja2.FileSystemLoader(TEMPLATES)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["plural"] = lambda count, word: f"{count:,} {word}{'s' * (count != 1)}"
    return environment, get_plotlyjs()


def packed(text: str) -> str:
    """Return `text` compressed and in base64; the page's script unpacks it."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def _sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
