"""Run folders for a page: read and pooled into lines; a folder that cannot be read is kept with the cause."""

import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.errors import InputError
from earl_jax.report.html.line_style import lightened, line_styles, shaded
from earl_jax.report.runs import Curves, MethodRuns, by_method, pooling_key, read_all
from earl_jax.report.style import colours
from earl_jax.report.tables import row_of
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder


class Run(NamedTuple):
    """One run folder; `config_json` is its whole config.json, with provenance."""

    path: Path
    config: RunConfig
    config_json: dict[str, Any]


class LeftOut(NamedTuple):
    """A folder that the page cannot show, and the cause."""

    path: Path
    cause: str


class Line(NamedTuple):
    """One method on one task, with the runs that its seeds come from.

    `key` identifies it on the page. `light` and `dark` are its colours on a light and on a dark page, `dash` its
    line style.
    """

    key: str
    group: MethodRuns
    runs: tuple[Run, ...]
    light: str
    dark: str
    dash: str

    @property
    def curves(self) -> Curves:
        """The curves of its seeds."""
        return self.group.curves

    @property
    def variant(self) -> str:
        """The options that tell this line from others of its method; empty if there are none."""
        return self.group.label[len(self.group.algo) + 2 : -1]

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seed of each row of the curves."""
        return tuple(seed for run in self.runs for seed in run.config.seeds)


def gather(paths: Sequence[Path]) -> tuple[list[Line], list[LeftOut]]:
    """Return the lines of run folders, by task and method in the paper's order, and folders that cannot be shown."""
    groups: dict[str, list[Run]] = {}
    left_out: list[LeftOut] = []
    for path in paths:
        try:
            run = _opened(path)
            groups.setdefault(pooling_key(run.config), []).append(run)
        except Exception as error:  # a folder is data: any error in it is reported and affects no other run
            left_out.append(LeftOut(path, _cause(error)))
    pooled = []
    for group in groups.values():
        curves, runs, unread = _pooled(group)
        left_out += unread
        if curves is not None:
            pooled.append((curves, tuple(runs)))
    return _lines(pooled), left_out


def _opened(path: Path) -> Run:
    """Return the run at `path`; an error means that its task, setting or method cannot be built here."""
    run = RunFolder.open(path)
    run.config.build_env()
    run.config.build_method()
    return Run(path, run.config, json.loads((path / "config.json").read_text()))


def _pooled(group: Sequence[Run]) -> tuple[Curves | None, list[Run], list[LeftOut]]:
    """Return the curves of as many runs of `group` as can be pooled, those runs, and the others with their causes."""
    try:
        return _checked(group), list(group), []
    except Exception as error:  # as in gather
        if len(group) == 1:
            return None, [], [LeftOut(group[0].path, _cause(error))]
    curves, pooled, left_out = None, [], []
    for run in group:
        try:
            curves = _checked([*pooled, run])
            pooled.append(run)
        except Exception as error:  # as in gather
            left_out.append(LeftOut(run.path, _cause(error)))
    return curves, pooled, left_out


def _checked(runs: Sequence[Run]) -> Curves:
    """Return the pooled curves of `runs`; an error means that a number of the tables cannot be computed from them."""
    curves = read_all([run.path for run in runs])[0]
    row_of(curves, 1, "")
    if not np.isfinite(curves.metrics["interventions"]).all():
        raise InputError("interventions are not finite")
    return curves


def _cause(error: Exception) -> str:
    """Return the error as a sentence; other errors than ValueErrors, which name the run, start with their kind."""
    return str(error) if isinstance(error, ValueError) else f"it cannot be read: {type(error).__name__}: {error}"


def _lines(pooled: Sequence[tuple[Curves, tuple[Run, ...]]]) -> list[Line]:
    lines: list[Line] = []
    runs = {id(curves): members for curves, members in pooled}
    palette = colours(curves.config.algo for curves, _ in pooled)
    groups = by_method([curves for curves, _ in pooled])
    for (_, algo), variants in itertools.groupby(groups, lambda group: (group.env, group.algo)):
        peers = list(variants)
        styles = line_styles([group.curves.config for group in peers], [group.curves.options for group in peers])
        for style, group in sorted(zip(styles, peers, strict=True), key=lambda pair: pair[0].rank):
            light = shaded(palette[algo], style.shade, style.shades)
            lines.append(
                Line(
                    key=f"c{len(lines)}",
                    group=group,
                    runs=runs[id(group.curves)],
                    light=light,
                    dark=lightened(light),
                    dash=style.dash,
                )
            )
    return lines
