"""The lines of a page: run folders, read and pooled; a folder that cannot be read is kept with the cause."""

import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from earl_jax.errors import InputError
from earl_jax.report.runs import Curves, MethodRuns, by_method, pooled, pooling_key, read
from earl_jax.report.scores import row_of
from earl_jax.report.style import colours, lightened, shaded
from earl_jax.runs.folder import RunFolder

DASHES = ("solid", "dash", "dot", "dashdot")


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
    runs: tuple[RunFolder, ...]
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
    groups: dict[str, tuple[Curves, list[RunFolder]]] = {}
    left_out: list[LeftOut] = []
    for path in paths:
        try:
            run = RunFolder.open(path)
            key = pooling_key(run.config)
            curves, members = _checked(read(path)), []
            if key in groups:
                earlier, members = groups[key]
                curves = _checked(pooled(members[0].path, [earlier, curves]))
            groups[key] = curves, [*members, run]
        except Exception as error:  # a folder is data: any error in it is reported and affects no other run
            text = (
                str(error) if isinstance(error, ValueError) else f"it cannot be read: {type(error).__name__}: {error}"
            )
            left_out.append(LeftOut(path, text))
    return _lines(list(groups.values())), left_out


def _checked(curves: Curves) -> Curves:
    """Return `curves`; an error means that the method cannot be built or that a number cannot be computed from them."""
    curves.config.build_method()
    row_of(curves, 1, "")
    if not np.isfinite(curves.metrics["interventions"]).all():
        raise InputError("interventions are not finite")
    return curves


def _lines(groups: Sequence[tuple[Curves, list[RunFolder]]]) -> list[Line]:
    """Return a line for each of `groups`; variants of a method have shades of its colour."""
    lines: list[Line] = []
    runs = {id(curves): members for curves, members in groups}
    palette = colours(curves.config.algo for curves, _ in groups)
    methods = by_method([curves for curves, _ in groups])
    for (_, algo), variants in itertools.groupby(methods, lambda group: (group.env, group.algo)):
        peers = list(variants)
        for number, group in enumerate(peers):
            light, dash = shaded(palette[algo], number, len(peers)), DASHES[number % len(DASHES)]
            members = tuple(runs[id(group.curves)])
            lines.append(Line(f"c{len(lines)}", group, members, light, lightened(light), dash))
    return lines


def recorded(run: RunFolder) -> dict[str, Any]:
    """Return the whole config.json of a run, with its provenance."""
    return json.loads(run.config_file.read_text())
