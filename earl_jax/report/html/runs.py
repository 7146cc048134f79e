"""Run folders as a page shows them: found, read and pooled into lines; what can't be read is kept with its cause."""

import dataclasses
import itertools
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.envs import make
from earl_jax.report.runs import Cell, Curves, cells_of, read_all
from earl_jax.report.style import colours
from earl_jax.report.tables import row_of
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder

DASHES = ("solid", "dash", "dot", "dashdot")
NIGHT = 160
"""How light, 0 to 255, a colour is at least where the page is dark."""


class Run(NamedTuple):
    """One run folder; `config_json` is its whole config.json, with provenance."""

    path: Path
    config: RunConfig
    config_json: dict[str, Any]


class LeftOut(NamedTuple):
    """A folder that the page can't show, and why."""

    path: Path
    cause: str


class Line(NamedTuple):
    """One method on one task, with the runs that its seeds come from.

    `key` names it on the page; `day` and `night` are its colours on white and on black, `dash` what its line looks like.
    """

    key: str
    cell: Cell
    runs: tuple[Run, ...]
    day: str
    night: str
    dash: str

    @property
    def told(self) -> str:
        """The options that tell this line from others of its method, nothing where it is alone."""
        return self.cell.label[len(self.cell.algo) + 2 : -1]

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seed of each row of the curves."""
        return tuple(seed for run in self.runs for seed in run.config.seeds)


def find(folders: Sequence[Path]) -> list[Path]:
    """Return the run folders in and below `folders`, each once; links to folders are not followed.

    Raises:
        ValueError: a folder does not exist, or holds no run.
    """
    if not folders:
        raise ValueError("name at least one run folder, or a folder of them")
    found: dict[Path, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            raise ValueError(f"{folder} is no folder")
        below = list(_below(folder))
        if not below:
            raise ValueError(f"{folder} is no run folder and holds none: there is no config.json in it or below")
        for path in below:
            found.setdefault(path.resolve(), path)
    return list(found.values())


def _below(folder: Path) -> Iterator[Path]:
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if name != "checkpoints")
        if "config.json" in files or "metrics.csv" in files:
            yield Path(place)


def gather(paths: Sequence[Path]) -> tuple[list[Line], list[LeftOut]]:
    """Return the lines of run folders, by task and method in the paper's order, and the folders that can't be shown."""
    groups: dict[str, list[Run]] = {}
    left_out: list[LeftOut] = []
    for path in paths:
        try:
            one = (run := _opened(path)).config
            groups.setdefault(repr((one.env, one.env_options, one.setting, one.algo, one.options)), []).append(run)
        except Exception as error:  # a folder is data: whatever is wrong with it is told, and costs no other run
            left_out.append(LeftOut(path, _cause(error)))
    found = []
    for group in groups.values():
        curves, kept, unread = _pooled(group)
        left_out += unread
        if curves is not None:
            found.append((curves, tuple(kept)))
    return _lines(found), left_out


def _opened(path: Path) -> Run:
    run = RunFolder.open(path)
    return Run(path, run.config, json.loads((path / "config.json").read_text()))


def _pooled(group: Sequence[Run]) -> tuple[Curves | None, list[Run], list[LeftOut]]:
    """Return the curves of as many runs of `group` as go together, those runs, and the others with their causes."""
    try:
        return _checked(group), list(group), []
    except Exception as error:  # as in gather
        if len(group) == 1:
            return None, [], [LeftOut(group[0].path, _cause(error))]
    curves, kept, left_out = None, [], []
    for run in group:
        try:
            curves = _checked([*kept, run])
            kept.append(run)
        except Exception as error:  # as in gather
            left_out.append(LeftOut(run.path, _cause(error)))
    return curves, kept, left_out


def _checked(runs: Sequence[Run]) -> Curves:
    """Return the pooled curves of `runs`, of which every number of the tables can be computed."""
    curves = read_all([run.path for run in runs])[0]
    row_of(curves, 1, "")
    if not np.isfinite(curves.metrics["interventions"]).all():
        raise ValueError("interventions are not finite")
    return curves


def _cause(error: Exception) -> str:
    """Return what went wrong in a sentence; errors that don't speak of runs get their kind before the text."""
    return str(error) if isinstance(error, ValueError) else f"it can't be read: {type(error).__name__}: {error}"


def _lines(found: Sequence[tuple[Curves, tuple[Run, ...]]]) -> list[Line]:
    lines: list[Line] = []
    runs = {id(curves): own for curves, own in found}
    palette = colours(curves.config.algo for curves, _ in found)
    for (_, algo), group in itertools.groupby(cells_of([curves for curves, _ in found]), lambda cell: cell[:2]):
        peers = list(group)
        options = [cell.curves.options for cell in peers]
        looks = _looks([_resolved(cell.curves.config, options) for cell in peers])
        for look, cell in sorted(zip(looks, peers, strict=True), key=lambda pair: pair[0].rank):
            day = shade(palette[algo], *look.shade)
            dash = DASHES[look.dash % len(DASHES)]
            lines.append(Line(f"c{len(lines)}", cell, runs[id(cell.curves)], day, lightened(day), dash))
    return lines


def _resolved(one: RunConfig, options: Sequence[dict[str, Any]]) -> tuple[tuple[int, float, str], ...]:
    """Return what a run has for each option that any of its peers changed, in a form that sorts numbers as numbers."""
    method = one.build_method()
    parts = (make(one.env, **one.env_options), one.build_setting(), method, method.sac)
    fields = {field.name: getattr(part, field.name) for part in parts for field in dataclasses.fields(part)}
    values = []
    for name in sorted({name for changed in options for name in changed}):
        value = fields.get(name, one.setting["name"])
        is_number = isinstance(value, int | float)
        values.append((0, float(value), "") if is_number else (1, 0.0, str(value)))
    return tuple(values)


class _Look(NamedTuple):
    """Where a line stands among its peers: `rank` sorts them, `shade` is its place and out of how many, `dash` a number."""

    rank: tuple[Any, ...]
    shade: tuple[int, int]
    dash: int


def _looks(values: Sequence[tuple[Any, ...]]) -> list[_Look]:
    """Return the look of each of several variants of a method by the `values` of their options.

    Where several options differ, the one with the fewest values is told by the dash and the others by the shade.
    """
    columns = [sorted(set(column)) for column in zip(*values, strict=True)]
    differing = [i for i, column in enumerate(columns) if len(column) > 1]
    by_dash = min(differing, key=lambda i: len(columns[i])) if len(differing) > 1 else None
    if by_dash is not None and len(columns[by_dash]) > len(DASHES):
        by_dash = None
    rests = [tuple(value for i, value in enumerate(one) if i != by_dash) for one in values]
    steps = sorted(set(rests))
    looks = []
    for one, rest in zip(values, rests, strict=True):
        place = steps.index(rest)
        dash = place if by_dash is None else columns[by_dash].index(one[by_dash])
        first = () if by_dash is None else (dash,)
        looks.append(_Look((*first, *rest), (place, len(steps)), dash))
    return looks


def mixed(colour: str, other: str, share: float) -> str:
    """Return `colour` (#RRGGBB) gone `share` of the way to `other`."""
    pairs = [(int(colour[i : i + 2], 16), int(other[i : i + 2], 16)) for i in (1, 3, 5)]
    return "#" + "".join(f"{round(a + share * (b - a)):02X}" for a, b in pairs)


def lightened(colour: str) -> str:
    """Return `colour` light enough to be seen on black."""
    light = sum(int(colour[i : i + 2], 16) for i in (1, 3, 5)) / 3
    return mixed(colour, "#FFFFFF", max(0.0, NIGHT - light) / (255 - light))


def shade(colour: str, place: int, count: int) -> str:
    """Return the `place`-th of `count` shades of a method's colour, from dark to light; the colour itself where it is alone."""
    if count == 1:
        return colour
    where = place / (count - 1)
    return (
        mixed(colour, "#000000", 0.45 * (1 - 2 * where))
        if where < 0.5
        else mixed(colour, "#FFFFFF", 1.1 * where - 0.55)
    )
