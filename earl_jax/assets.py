"""Finds what ships beside the code, in a checkout and in a wheel: models, demonstrations, the paper's tables."""

import csv
import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np

DIRECTIONS = ("forward", "backward")


class Demos(NamedTuple):
    """Demonstrations of one direction, concatenated: float32 `states [T, s]`, `goals [T, g]`, `actions [T, a]`,
    `next_states [T, s]`, `rewards [T]` and bool `ends [T]`, true on the last transition of each demonstration."""

    states: np.ndarray
    goals: np.ndarray
    actions: np.ndarray
    next_states: np.ndarray
    rewards: np.ndarray
    ends: np.ndarray


def root() -> Path:
    """Return the folder of assets: beside the package in a checkout, inside it in a wheel."""
    package = Path(__file__).resolve().parent
    for folder in (package / "assets", package.parent / "assets"):
        if (folder / "mjcf").is_dir():
            return folder
    raise FileNotFoundError(f"no assets folder in {package} or beside it: reinstall earl_jax")


def _file(kind: str, name: str, suffix: str) -> Path:
    path = root() / kind / f"{name}{suffix}"
    if name.endswith(suffix) and Path(name).is_file():
        return Path(name)
    if not path.is_file():
        choices = sorted(entry.stem for entry in path.parent.glob(f"*{suffix}"))
        raise ValueError(f"no {kind} for {name!r}; choose from {', '.join(choices)}")
    return path


def mjcf(name: str) -> Path:
    """Return the path of a task's MJCF; an unknown name is a ValueError that lists the choices."""
    return _file("mjcf", name, ".xml")


@functools.cache
def demos(name: str, direction: str) -> Demos:
    """Return the demonstrations of task `name` (or of an npz file), `direction` forward or backward, as read-only arrays.

    Raises:
        ValueError: the task has no demonstrations, or the direction is unknown; the message lists the choices.
    """
    if direction not in DIRECTIONS:
        raise ValueError(f"unknown direction {direction!r}; choose from {', '.join(DIRECTIONS)}")
    path = _file("demos", name, ".npz")
    with np.load(path, allow_pickle=False) as stored:
        if f"{direction}_states" not in stored:
            raise ValueError(f"{path.name} has no {direction} demonstrations")
        arrays = [stored[f"{direction}_{field}"] for field in Demos._fields]
    for array in arrays:
        array.setflags(write=False)
    return Demos(*arrays)


def demo_directions(name: str) -> tuple[str, ...]:
    """Return which of `DIRECTIONS` the demonstrations of task `name` (or an npz file) have; none where there are none."""
    path = Path(name) if name.endswith(".npz") else root() / "demos" / f"{name}.npz"
    if not path.is_file():
        return ()
    with np.load(path, allow_pickle=False) as stored:
        return tuple(direction for direction in DIRECTIONS if f"{direction}_states" in stored)


def has_demos(name: str) -> bool:
    """Return whether demonstrations ship for task `name`."""
    return (root() / "demos" / f"{name}.npz").is_file()


@functools.cache
def starts(name: str) -> dict[str, np.ndarray]:
    """Return the settled starts of task `name` as read-only float32 arrays [N, ...], by the field of the physics state.

    Raises:
        ValueError: no starts ship for the task; the message lists those for which they do.
    """
    with np.load(_file("starts", name, ".npz"), allow_pickle=False) as stored:
        arrays = dict(stored)
    for array in arrays.values():
        array.setflags(write=False)
    return arrays


@functools.cache
def published(table: str) -> list[dict[str, str]]:
    """Return a table of the paper (`table1`, `table2`, `crossings`, ...) as rows of column to text."""
    with _file("published", table, ".csv").open(newline="") as handle:
        return list(csv.DictReader(handle))


def published_row(table: str, **where: str) -> dict[str, str]:
    """Return the first row of a table of the paper that holds `where`, column by column; an empty one where none does."""
    return next((row for row in published(table) if where.items() <= row.items()), {})
