"""The definition of a table or figure of the paper: the runs that it needs, and the files made from them.

Source of tasks, methods and lengths: Sharma et al. 2022, tables 1 and 2.
"""

import dataclasses
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.envs import make
from earl_jax.metrics.statistics import STDERR_RULE, stderr
from earl_jax.report import style
from earl_jax.report.published import training_steps
from earl_jax.report.tables import Row, error_text, write
from earl_jax.runs.files import written

PAGES = Path(__file__).parent / "pages"
METHODS = tuple(style.COLOURS)
Options = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Block:
    """Runs on one task that differ only in their method, or in `options` that hold lists of alternatives."""

    env: str
    algos: tuple[str, ...]
    steps: int
    options: Options = dataclasses.field(default_factory=dict)
    eval_every_factor: int = 1
    """Factor on the scale's `eval_every`, for tasks whose evaluations take long."""


class Report(NamedTuple):
    """The content of an artefact's files: parts of its page by name, a matplotlib figure, rows by the end of a csv's name."""

    parts: dict[str, str]
    figure: Any
    tables: dict[str, list[Row]]
    page: str | None = None
    """The name of the page's text in the folder pages, by default that of the artefact."""

    def text(self, name: str) -> str:
        """Return the page of artefact `name`: pages/`page`.md with the parts in their places, without empty paragraphs."""
        page = (PAGES / f"{self.page or name}.md").read_text().format(stderr=STDERR_RULE, **self.parts)
        return re.sub(r"\n{3,}", "\n\n", page).rstrip() + "\n"

    def write(self, name: str, out: Path) -> list[Path]:
        """Write `name`*.csv, `name`.md and `name`.png into the folder `out`, and return them."""
        tables = {out / f"{name}{end}.csv": rows for end, rows in self.tables.items()}
        for path, rows in tables.items():
            write(rows, path)
        page = written(out / f"{name}.md", self.text(name))
        return [*tables, page, style.save(self.figure, out / f"{name}.png")]


@dataclasses.dataclass(frozen=True)
class Artefact:
    """A table or figure: its possible tasks, the runs on each of them, and the report made of their folders.

    `report` raises a ValueError if a folder holds no run that belongs to it, or matplotlib is not installed.
    """

    name: str
    tasks: tuple[str, ...]
    blocks: Callable[[str], list[Block]]
    report: Callable[[Sequence[Path]], Report]
    variants: bool = False
    """Whether `report` accepts runs of a method that differ in options other than those of its block."""

    def write(self, folders: Sequence[Path], out: Path) -> list[Path]:
        """Write the report on run `folders` into `out` and return its files: csv, md, png. Raises as `report`."""
        return self.report(folders).write(self.name, out)


def methods_on(env: str, methods: tuple[str, ...] = METHODS) -> tuple[str, ...]:
    """Return the `methods` that can run on a task: VaPRL needs demonstrations."""
    has_demos = make(env).demonstrations.recorded
    return tuple(method for method in methods if has_demos or method != "vaprl")


def runs_of(*methods: str) -> Callable[[str], list[Block]]:
    """Return the function from a task of the paper to the runs of `methods` on it, at their published length."""
    return lambda env: [Block(env, methods_on(env, methods), training_steps(env))]


def column(rows: Iterable[Row], name: str) -> np.ndarray:
    """Return the numbers [rows] of a column, nan for None."""
    return np.array([row[name] for row in rows], float)


def mean_text(values: np.ndarray, style: str) -> str:
    """Return the mean of `values [seeds]` in a format, with the standard error in brackets if there are several."""
    return error_text(values.mean(), stderr(values), style)
