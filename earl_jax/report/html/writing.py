"""One self-contained html page of run folders: curves, tables, seeds, maps, videos, and where all of it comes from."""

import base64
import gzip
import hashlib
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from earl_jax.report.html.content import content, numbers
from earl_jax.report.html.origin import repeat
from earl_jax.report.html.runs import find, gather
from earl_jax.runs.files import write_atomically

TEMPLATES = Path(__file__).parent / "templates"


def write_page(folders: Sequence[Path], out: Path) -> Path:
    """Write the page of the runs in and below `folders` to `out`, an .html file, and return it.

    Runs that can't be read are listed on the page with the cause.

    Raises:
        ValueError: `out` is no .html file, a folder holds no run, none of the runs can be read, or a library is missing.
    """
    if out.suffix != ".html" or out.is_dir():
        raise ValueError(f"{out}: a report is written as an .html file")
    environment, plotly = _environment(), _plotly()
    lines, left_out = gather(find(folders))
    if not lines:
        causes = "\n".join(f"  {one.path}: {one.cause}" for one in left_out)
        raise ValueError(f"none of the runs can be shown:\n{causes}")
    told = content(lines)
    script, style = ((TEMPLATES / f"report.{kind}").read_text() for kind in ("js", "css"))
    page = environment.get_template("report.html").render(
        told,
        left_out=left_out,
        repeat=repeat(folders, out),
        style=_raw(style),
        script=_raw(script),
        plotly=packed(plotly),
        numbers=packed(json.dumps(numbers(told), allow_nan=False)),
        hashes=" ".join(f"'sha256-{_sha256(text)}'" for text in (script, plotly)),
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    # Plain ASCII reads the same whatever encoding the place has where it is written or opened.
    write_atomically(out, page.encode("ascii", "xmlcharrefreplace").decode())
    return out


def _environment() -> Any:
    try:
        import jinja2
    except ImportError as error:
        raise ValueError("reports need jinja2: pip install 'earl-jax[report]'") from error
    loader = jinja2.FileSystemLoader(TEMPLATES)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["ticks"] = _ticks
    environment.filters["plural"] = lambda count, word: f"{count:,} {word}{'s' * (count != 1)}"
    return environment


def _ticks(text: str) -> Any:
    """Return `text` as html, with what stands in backticks as code."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def _plotly() -> str:
    """Return plotly.js as its Python package ships it."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise ValueError("reports need plotly: pip install 'earl-jax[report]'") from error
    return get_plotlyjs()


def _raw(text: str) -> Any:
    from markupsafe import Markup

    return Markup(text)


def packed(text: str) -> str:
    """Return `text` compressed and as base64, which the page's script unpacks."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def _sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
