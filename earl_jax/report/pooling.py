"""Runs found in folders, with the seeds of equal runs pooled."""

import contextlib
import functools
import json
import os
from collections import ChainMap
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax.errors import InputError, brief
from earl_jax.metrics.scores import CONTINUING, DEFAULT, Window, require_window
from earl_jax.report.runs import Columns, Curves, by_method, by_values, read
from earl_jax.report.scores import over_same_steps, seed_scores
from earl_jax.runs.config import DEPLOYED, RunConfig
from earl_jax.runs.contents import CHECKPOINTS, CONFIG, METRICS, is_run
from earl_jax.runs.files import warn

Check = Callable[[Curves], Any]
"""A function that raises an error if curves lack what a report shows of them."""
NEEDED = frozenset(DEPLOYED.values())
"""Metrics without which a run is not pooled; of the others, pooled runs keep those that all of them have."""
MOST_CAUSES = 5
"""Most causes in the error that no run can be used."""


def find_runs(folders: Sequence[str | Path]) -> list[Path]:
    """Return the run folders among `folders`, and those below the others, each once; links are followed to runs alone.

    A `RunWarning` names a folder below them that cannot be read.

    Raises:
        ValueError: a folder does not exist, holds no run, or is no `Path`.
    """
    is_list = isinstance(folders, Sequence) and not isinstance(folders, str)
    if not is_list or not all(isinstance(folder, str | os.PathLike) for folder in folders):
        raise InputError(f"the folders must be a list of paths, such as ['runs'], not {brief(folders)}")
    if not folders:
        raise InputError("name at least one run folder, or a folder of them")
    paths: dict[Path, Path] = {}
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise InputError(f"{folder} is not a folder")
        below = [folder] if is_run(folder) else list(_runs_below(folder))
        if not below:
            raise InputError(f"{folder} is not a run folder and holds none: no {CONFIG} in it or below")
        for path in below:
            paths.setdefault(path.resolve(), path)
    return list(paths.values())


def _runs_below(folder: Path) -> Iterator[Path]:
    for path, folders, files in os.walk(folder, onerror=_warn_of_unread):
        folders[:] = sorted(set(folders) - {CHECKPOINTS})
        if CONFIG in files or METRICS in files:
            yield Path(path)
        yield from (link for link in map(Path(path).joinpath, folders) if link.is_symlink() and is_run(link))


def _warn_of_unread(error: OSError) -> None:
    warn(f"left out: {error.filename} can't be read: {error.strerror}")


def gather(
    folders: Sequence[str | Path], window: Window = DEFAULT, check: Check = lambda curves: None
) -> tuple[list[Curves], dict[Path, str]]:
    """Return the curves of the runs that `find_runs` finds, and the causes of those that are left out, by folder.

    Seeds of one run are apart where they have other hyper-parameters. Those of the same task, method and options are pooled
    over their common steps, and a seed that ran more than once counts once, by the mean of its runs. A run is left out if it
    cannot be read or pooled with longer and earlier ones, or if `check` of the pooled curves raises an error.

    Raises:
        ValueError: a folder does not exist or holds no run, no run can be read, or `window` is no `Window`.
    """
    require_window(window)
    found: dict[Path, list[tuple[str, Curves]]] = {}
    left_out: dict[Path, str] = {}
    for path in find_runs(folders):
        with _left_out_on_error(path, left_out):
            found[path] = [(pooling_key(curves.config), curves) for curves in by_values(read(path, window))]
    parts, runs = _pools(found, left_out, check)
    if not runs:
        causes = list(left_out.values())
        more = [f"and {len(causes) - MOST_CAUSES} more"] if len(causes) > MOST_CAUSES else []
        text = "\n  ".join(["none of the runs can be used:", *causes[:MOST_CAUSES], *more])
        raise InputError(causes[0] if len(causes) == 1 else text)
    for key, run in runs.items():
        _warn_if_shortened(run, parts[key])
        runs[key] = _over_steps_of(parts[key], run)
    return [_once(runs[key]) for key in parts if key in runs], left_out


def _pools(
    found: dict[Path, list[tuple[str, Curves]]], left_out: dict[Path, str], check: Check
) -> tuple[dict[str, list[Curves]], dict[str, Curves]]:
    """Return the parts of each pool of the runs `found`, by key, and the pools; runs that do not fit go to `left_out`."""
    parts: dict[str, list[Curves]] = {key: [] for run in found.values() for key, _ in run}
    pools: dict[str, Curves] = {}
    for path in sorted(found, key=lambda path: -found[path][0][1].length):  # a run before a copy of its beginning
        with _left_out_on_error(path, left_out):
            extended = ChainMap({}, pools)
            for key, curves in found[path]:
                check(curves)
                pool = curves
                if key in extended:
                    pool = pooled((extended[key], curves))
                    _check_copied(pool, curves.seeds)
                    check(pool)
                extended[key] = pool
            pools |= extended.maps[0]  # all parts of a run or none
            for key, curves in found[path]:
                parts[key].append(curves)
    return parts, pools


@contextlib.contextmanager
def _left_out_on_error(path: Path, left_out: dict[Path, str]) -> Iterator[None]:
    """Add `path` with the text of an error in this context to `left_out`: a folder is data, which affects no other run."""
    try:
        yield
    except Exception as error:
        text = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        left_out[path] = text if str(path) in text else f"{path}: {text}"


def _check_copied(run: Curves, added: int) -> None:
    """Raise an InputError if each of the `added` last seeds has the numbers of an earlier one, as in a copied folder."""
    seeds = run.run_seeds
    if not set(seeds[-added:]) <= set(seeds[:-added]):
        return
    lives = [(seed, *(values[row].tobytes() for values in run.metrics.values())) for row, seed in enumerate(seeds)]
    earlier, last = lives[:-added], lives[-added:]
    if set(last) <= set(earlier):
        paths = [folder.path for folder in run.runs for _ in folder.config.seeds]
        row = earlier.index(last[0])
        same = f"{paths[-1]} has the same numbers of seed {seeds[row]} as {paths[row]}"
        raise InputError(f"{same}; a seed counts once: leave one of them out")


def _once(run: Curves) -> Curves:
    """Return `run` with a row for each seed: the mean of its runs, which are not independent. A `RunWarning` names them."""
    seeds, repeated = run.run_seeds, run.repeated_seeds
    if not repeated:
        return run
    paths = " and ".join(str(folder.path) for folder in run.runs if {*repeated} & {*folder.config.seeds})
    warn(f"{paths} have seed {', '.join(map(str, repeated))}; each counts once, by the mean of its runs")
    rows = [np.equal(seeds, seed) for seed in dict.fromkeys(seeds)]
    means = {name: np.stack([values[row].mean(axis=0) for row in rows]) for name, values in run.metrics.items()}
    return run._replace(metrics=Columns(run.runs[0].path, means))


def _over_steps_of(parts: Sequence[Curves], run: Curves) -> Curves:
    """Return the `run` that is pooled of `parts`, scored over as many steps as they are, though it has fewer evaluations."""
    has_all = all(len(run.steps) == (part.steps <= run.length).sum() for part in parts)
    return run if has_all else run._replace(window=over_same_steps(parts, run.length)[0].window)


def _warn_if_shortened(run: Curves, parts: Sequence[Curves]) -> None:
    """Warn if the `run` that is pooled of `parts` ends before the longest of them."""
    shortest, longest = (choice(parts, key=lambda part: part.length) for choice in (min, max))
    if run.length < longest.length:
        paths = [part.runs[0].path for part in (longest, shortest)]
        counted = f"counts up to step {run.length} of {longest.length} only"
        warn(f"{paths[0]} is pooled with {paths[1]} and {counted}")


def read_all(
    folders: Sequence[str | Path], window: Window = DEFAULT, check: Check = lambda curves: None
) -> list[Curves]:
    """Return the pooled curves of `folders`. Runs below them that `gather` leaves out are named by a `RunWarning`.

    Raises:
        ValueError: as `gather`, or one of `folders` is itself a run that is left out.
    """
    runs, left_out = gather(folders, window, check)
    for path, cause in left_out.items():
        if path in map(Path, folders):
            raise InputError(cause)
        warn(f"left out: {cause}")
    return runs


def pooling_key(config: RunConfig) -> str:
    """Return a text that is the same for runs whose seeds can be pooled: same task, setting, method, options and classes."""
    values = [config.env, config.env_options, config.setting, config.algo, config.options]
    values += [config.env_class, config.algo_class]
    plain = json.loads(json.dumps(values, default=repr), parse_int=float)  # 1 and 1.0 are the same option
    return json.dumps(plain, sort_keys=True)


def pooled(parts: Sequence[Curves]) -> Curves:
    """Return the curves of the seeds of all `parts`, over their common steps.

    Raises:
        ValueError: they have no step in common, or one lacks a metric of `NEEDED`, or rewards that others have.
    """
    config, folders = parts[0].config, tuple(folder for part in parts for folder in part.runs)
    steps = functools.reduce(np.intersect1d, [part.steps for part in parts])
    if not len(steps):
        raise InputError(
            f"{folders[-1].path} and {folders[0].path} have no evaluation step in common, "
            "and runs of one task, method and options are pooled; leave one of them out"
        )
    if len({bool(np.isnan(part.metrics[CONTINUING]).all()) for part in parts}) > 1:
        raise InputError(
            f"of {folders[-1].path} and {folders[0].path}, which would be pooled, one has no column {CONTINUING!r}"
        )
    metrics = {
        name: np.concatenate([part.metrics[name][:, np.isin(part.steps, steps)] for part in parts])
        for name in parts[0].metrics
        if name in NEEDED or all(name in part.metrics for part in parts)
    }
    return Curves(config, steps, Columns(folders[0].path, metrics), folders, parts[0].window)


def read_methods(folders: Sequence[str | Path], window: Window = DEFAULT, metric: str | None = None) -> list[Curves]:
    """Return the pooled runs of `folders` with a score by `metric`, by task and method in the paper's order.

    Errors as `read_all`.
    """
    return by_method(read_all(folders, window, functools.partial(seed_scores, metric=metric)))
