"""Files that ship with the code, in a checkout or in a wheel, and demonstration files of users."""

from __future__ import annotations

import csv
import functools
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from earl_jax.errors import InputError, choices, is_of_package, require_known
from earl_jax.npz import load_npz, read_bytes

if TYPE_CHECKING:
    import numpy as np

DIRECTIONS = ("forward", "backward")


class Demos(NamedTuple):
    """Transitions of the demonstrations of one direction, concatenated.

    Float32 `states [T, s]`, `goals [T, g]`, `actions [T, a]`, `next_states [T, s]`, `rewards [T]`, and bool `ends [T]`, which is
    true on the last transition of each demonstration.
    """

    states: np.ndarray
    goals: np.ndarray
    actions: np.ndarray
    next_states: np.ndarray
    rewards: np.ndarray
    ends: np.ndarray


def spans(ends: np.ndarray) -> list[slice]:
    """Return the rows of each demonstration as slices; `ends [T]` marks the last transition of each (see `Demos`)."""
    stops = (ends[:-1].nonzero()[0] + 1).tolist()
    return [slice(*span) for span in itertools.pairwise([0, *stops, len(ends)])]


def root() -> Path:
    """Return the folder of assets: beside the package in a checkout, inside it in a wheel.

    Raises:
        FileNotFoundError: the installation has no such folder.
    """
    package = Path(__file__).resolve().parent
    for folder in (package / "assets", package.parent / "assets"):
        if (folder / "mjcf").is_dir():
            return folder
    raise FileNotFoundError(f"no assets folder in {package} or beside it: reinstall earl_jax")


def _file(kind: str, name: str, suffix: str) -> Path:
    """Return the file of `name` in the assets of `kind`, or the file at the path `name`."""
    known = {entry.stem: entry for entry in sorted((root() / kind).glob(f"*{suffix}"))}
    path = known.get(name, Path(name))
    if not path.is_file():
        is_name = path.name == name and path.suffix != suffix
        cause = choices(name, known) if is_name else "there is no such file"
        raise InputError(f"no {kind} for {name!r}; {cause}")
    return path


def asset_name(task: Any) -> str:
    """Return the name of the files of a `task`: its own, or that of the task of this package which its class extends."""
    return getattr(next(filter(is_of_package, type(task).__mro__)), "name", task.name)


def mjcf(name: str) -> Path:
    """Return the path of the MJCF file of task `name`.

    Raises:
        ValueError: the task has no such file; the message lists the choices.
    """
    return _file("mjcf", name, ".xml")


def demos(name: str, direction: str) -> Demos:
    """Return the forward or backward demonstrations of task `name`, or of the npz file at that path, as read-only arrays.

    Raises:
        ValueError: the task or file has no such demonstrations, or the direction is unknown (the message lists the
            choices); they fail `checked_demos`; or the file has changed since this process read it.
    """
    require_known("direction", direction, DIRECTIONS)
    path = _file("demos", name, ".npz")
    read, changed = _read_demos(path, direction)
    require_unchanged(path, changed)
    return read


def require_unchanged(path: Path, changed: int) -> None:
    """Raise an InputError unless `path` was last changed at `changed`, in ns, the time when this process read it."""
    if path.stat().st_mtime_ns != changed:  # compiled programs have the first content
        raise InputError(
            f"{path} has changed since this process read it: restart it, or choose another name for the new file"
        )


@functools.cache
def _read_demos(path: Path, direction: str) -> tuple[Demos, int]:
    """Return the demonstrations in the npz file `path`, and when it was last changed. Errors as `demos`."""
    changed = path.stat().st_mtime_ns
    stored = _arrays(path, [f"{direction}_{field}" for field in Demos._fields])
    if f"{direction}_states" not in stored:
        demo_directions(str(path))  # an error of its own where there are none in either direction
        raise InputError(f"{path.name} has no {direction} demonstrations")
    if len(stored) < len(Demos._fields):
        raise InputError(f"{path} is damaged: it lacks arrays of the {direction} demonstrations")
    try:
        demos = checked_demos(Demos._make(stored.values()))
    except InputError as error:
        raise InputError(f"{path}: {direction} demonstrations: {error}") from error
    for array in demos:
        array.setflags(write=False)
    return demos, changed


def checked_demos(demos: Demos) -> Demos:
    """Return `demos` with the types of `Demos`.

    Raises:
        ValueError: there are no transitions, the arrays do not fit together, a number is not finite, an action is
            outside [-1, 1], or a demonstration has a gap or no end.
    """
    import numpy as np

    with np.errstate(over="ignore"):  # too large values become infinite, which the check below finds
        numbers = [array.astype(np.float32, copy=False) for array in demos[:-1]]
    demos = Demos._make([*numbers, demos.ends.astype(bool, copy=False)])
    shapes = {name: array.shape for name, array in demos._asdict().items()}
    fit = [array.ndim for array in demos] == [2, 2, 2, 2, 1, 1] and demos.states.shape == demos.next_states.shape
    if not fit or {len(array) for array in demos} != {demos.ends.size or None}:
        raise InputError(f"the arrays don't fit together: {shapes}")
    for name, array in demos._asdict().items():
        if not np.isfinite(array).all():
            raise InputError(f"the {name} have values that are not finite")
    if (np.abs(demos.actions) > 1).any():
        raise InputError("the actions have values outside [-1, 1]")
    if not demos.ends[-1]:
        raise InputError("the last demonstration stops in the middle of an episode")
    follows = np.isclose(demos.states[1:], demos.next_states[:-1], rtol=1e-4, atol=1e-4).all(axis=1) | demos.ends[:-1]
    if not follows.all():
        row = int(np.argmin(follows))
        raise InputError(f"row {row + 1} does not begin where row {row} arrives, and row {row} ends no episode")
    return demos


def demo_directions(name: str) -> tuple[str, ...]:
    """Return the directions of the demonstrations of task `name`, or of the npz file at that path.

    Raises:
        ValueError: there are no such demonstrations; the message lists the choices.
    """
    path = _file("demos", name, ".npz")
    stored = _arrays(path, [f"{direction}_states" for direction in DIRECTIONS])
    if not stored:
        raise InputError(
            f"{path} has no demonstrations: it lacks forward_states and backward_states; "
            "`earl-jax import-demos` converts recordings of the original"
        )
    return tuple(direction for direction in DIRECTIONS if f"{direction}_states" in stored)


def _arrays(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the arrays called `names` from an npz file, which can be a user's own, as far as it contains them."""
    try:
        return load_npz(read_bytes(path), names)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def has_demos(name: str) -> bool:
    """Return whether demonstrations ship for task `name`."""
    return (root() / "demos" / f"{name}.npz").is_file()


@functools.cache
def _shipped(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an npz file that ships, read-only, by name."""
    import numpy as np  # `earl-jax list` starts faster without it

    with np.load(path, allow_pickle=False) as stored:
        arrays = dict(stored)
    for array in arrays.values():
        array.setflags(write=False)
    return arrays


def starts(name: str) -> dict[str, np.ndarray]:
    """Return the stored starts of task `name`, which are settled states, as read-only float32 arrays [N, ...] by name.

    Raises:
        ValueError: the task has no such file; the message lists the choices.
    """
    return _shipped(_file("starts", name, ".npz"))


def list_pretrained() -> dict[str, list[str]]:
    """Return for each task the methods whose trained policies ship, both sorted."""
    files = sorted((root() / "pretrained").glob("*/*.json"))
    tasks = dict.fromkeys(path.parent.name for path in files)
    return {task: [path.stem for path in files if path.parent.name == task] for task in tasks}


def pretrained(task: str, method: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return `pretrained_info`, and the parameters of the policies, float16 [N, ...] by name. Errors as `pretrained_info`."""
    return pretrained_info(task, method), _shipped(root() / "pretrained" / task / f"{method}.npz")


def pretrained_info(task: str, method: str) -> dict[str, Any]:
    """Return information on the shipped trained policies of `method` on `task`, as plain values.

    `config`: the config of the run, with the versions and the commit that made it; `step`: the training steps; `seeds`:
    the seeds whose policies ship; `deployed/success` and `deployed/return`: their scores over `episodes` greedy
    episodes of the float16 actors; `run`: the mean of the last `evaluations` evaluations for every seed of the run.

    Raises:
        ValueError: no such policies ship; the message lists the choices.
    """
    shipped = list_pretrained()
    if task not in shipped:
        raise InputError(f"no trained policies ship for {task!r}; {choices(task, shipped)}")
    if method not in shipped[task]:
        raise InputError(f"no policies of {method!r} ship for {task}; {choices(method, shipped[task])}")
    return json.loads((root() / "pretrained" / task / f"{method}.json").read_text())


def published(table: str) -> list[dict[str, str]]:
    """Return a table of published results (`table1`, `table2`, `steps`, ...) as rows of text by column; a fresh copy.

    Raises:
        ValueError: there is no such table; the message lists the choices.
    """
    return [dict(row) for row in _read_published(table)]


@functools.cache
def _read_published(table: str) -> list[dict[str, str]]:
    with _file("published", table, ".csv").open(newline="") as handle:
        return list(csv.DictReader(handle))


def published_row(table: str, **where: str) -> dict[str, str]:
    """Return the first row of a published table whose columns have the values `where`, or {} if there is none."""
    return next((dict(row) for row in _read_published(table) if where.items() <= row.items()), {})


def released_runs(task: str, method: str) -> dict[str, np.ndarray]:
    """Return the released evaluations of the paper's five seeds: `steps [E]`, and float32 [5, E] of `deployed` and `continuing`.

    `deployed` is a success rate or a return, `continuing` the reward per step so far. What was not released is missing.
    Source: arrays of the repository earl_benchmark at commit b05b000, up to the shortest seed. They contain no steps.
    For naive RL, FBRL and VaPRL the environment is reset two rows before multiples of the horizon, so their first row
    is after 20,000 steps, presumably 10,000 random steps and 10,000 of training. We assume the same for the oracle.
    R3L's first row is after one interval. Arrays are read-only.
    """
    own, curves = f"{task}/{method}/", _shipped(root() / "published" / "curves.npz")
    return {name.removeprefix(own): array for name, array in curves.items() if name.startswith(own)}
