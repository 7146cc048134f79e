"""How the lines of a page look: shades and dashes that tell the variants of a method apart."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

from earl_jax.envs import make
from earl_jax.runs.config import RunConfig

DASHES = ("solid", "dash", "dot", "dashdot")
LEAST_BRIGHTNESS = 160
"""Least brightness of a colour on a dark page, 0 to 255."""

OptionValues = tuple[tuple[int, float, str], ...]
"""The values of several options in a form that sorts numbers by size, before texts."""


class LineStyle(NamedTuple):
    """The style of a line among the variants of its method.

    `rank` sorts the variants; `shade` counts from 0, the darkest of `shades`; `dash` is one of `DASHES`.
    """

    rank: tuple[Any, ...]
    shade: int
    shades: int
    dash: str


def line_styles(configs: Sequence[RunConfig], options: Sequence[dict[str, Any]]) -> list[LineStyle]:
    """Return a style for each of several variants of a method, given their configs and changed `options`."""
    names = sorted({name for changed in options for name in changed})
    return _styles([_option_values(config, names) for config in configs])


def _option_values(config: RunConfig, names: Sequence[str]) -> OptionValues:
    """Return the values that a run has for the options `names`, defaults included."""
    method = config.build_method()
    parts = (make(config.env, **config.env_options), config.build_setting(), method, method.sac)
    fields = {field.name: getattr(part, field.name) for part in parts for field in dataclasses.fields(part)}
    values = []
    for name in names:
        value = fields.get(name, config.setting["name"])
        is_number = isinstance(value, int | float)
        values.append((0, float(value), "") if is_number else (1, 0.0, str(value)))
    return tuple(values)


def _styles(values: Sequence[OptionValues]) -> list[LineStyle]:
    """Return a style for each variant.

    If several options differ, the dash shows the one with the fewest values, and the shade shows the others.
    """
    columns = [sorted(set(column)) for column in zip(*values, strict=True)]
    differing = [i for i, column in enumerate(columns) if len(column) > 1]
    dashed = min(differing, key=lambda i: len(columns[i])) if len(differing) > 1 else None
    if dashed is not None and len(columns[dashed]) > len(DASHES):
        dashed = None
    shaded = [tuple(value for i, value in enumerate(variant) if i != dashed) for variant in values]
    shades = sorted(set(shaded))
    styles = []
    for variant, rest in zip(values, shaded, strict=True):
        shade = shades.index(rest)
        dash = shade if dashed is None else columns[dashed].index(variant[dashed])
        rank = rest if dashed is None else (dash, *rest)
        styles.append(LineStyle(rank=rank, shade=shade, shades=len(shades), dash=DASHES[dash % len(DASHES)]))
    return styles


def mixed(colour: str, other: str, share: float) -> str:
    """Return `colour` (#RRGGBB) moved by `share` of the way to `other`."""
    pairs = [(int(colour[i : i + 2], 16), int(other[i : i + 2], 16)) for i in (1, 3, 5)]
    return "#" + "".join(f"{round(a + share * (b - a)):02X}" for a, b in pairs)


def lightened(colour: str) -> str:
    """Return `colour`, lightened if necessary so that it can be seen on black."""
    brightness = sum(int(colour[i : i + 2], 16) for i in (1, 3, 5)) / 3
    return mixed(colour, "#FFFFFF", max(0.0, LEAST_BRIGHTNESS - brightness) / (255 - brightness))


def shaded(colour: str, shade: int, count: int) -> str:
    """Return number `shade` of `count` shades of a colour, from dark to light; a single shade is the colour."""
    if count == 1:
        return colour
    share = shade / (count - 1)
    if share < 0.5:
        return mixed(colour, "#000000", 0.45 * (1 - 2 * share))
    return mixed(colour, "#FFFFFF", 1.1 * share - 0.55)
