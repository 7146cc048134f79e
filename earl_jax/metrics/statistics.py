"""Statistics over seeds: mean, standard error, interquartile mean, relative drops and stratified-bootstrap intervals.

Source: Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice", section 4.

Every function accepts NumPy arrays and returns float64 numbers, or accepts JAX arrays, also inside `jit` and `vmap`,
and returns JAX arrays. Both resample the same seeds, so their intervals agree up to rounding.
"""

from typing import Any, NamedTuple

import numpy as np

from earl_jax.errors import InputError

RESAMPLES = 2000
STDERR_RULE = "the population deviation over the root of the number of seeds, as in the paper's tables"
"""What `stderr` returns, in words for a note below a table."""


class Estimate(NamedTuple):
    """A number with its 95 % interval; the ends are nan if there are too few seeds."""

    value: Any
    low: Any
    high: Any

    def columns(self, name: str, prefix: str = "") -> dict[str, Any]:
        """Return the columns `name`, `low` and `high` for a row; the names of the last two start with `prefix`."""
        return dict(zip((name, f"{prefix}low", f"{prefix}high"), self, strict=True))

    @classmethod
    def of_row(cls, row: dict[str, Any], name: str) -> "Estimate":
        """Return the estimate from its `columns` in `row`; the names of the ends can start with `name` and `_`."""
        prefix = f"{name}_" if f"{name}_low" in row else ""
        return cls(row[name], row[f"{prefix}low"], row[f"{prefix}high"])


class Summary(NamedTuple):
    """A summary of scores: `mean`, `stderr`, `iqm` with its 95 % interval `low` to `high`, number of `seeds`."""

    mean: Any
    stderr: Any
    iqm: Any
    low: Any
    high: Any
    seeds: int


def namespace_of(*arrays: Any) -> Any:
    """Return the array module of `arrays`: `jax.numpy` if one of them is a JAX array or traced, else `numpy`.

    It is the array API's `__array_namespace__`; lists and Python numbers count as NumPy arrays.
    """
    modules = [array.__array_namespace__() for array in arrays if hasattr(array, "__array_namespace__")]
    return next((module for module in modules if module is not np), np)


def as_float(value: Any) -> Any:
    """Return a NumPy scalar as a Python float, which tables and JSON accept; a JAX array stays as it is."""
    return float(value) if namespace_of(value) is np else value


def stderr(scores: Any) -> Any:
    """Return the standard error over the first axis: population deviation / sqrt(n) (paper); nan for one seed."""
    seeds = np.shape(scores)[0]
    return namespace_of(scores).std(scores, axis=0) / (np.sqrt(seeds) if seeds > 1 else np.nan)


def iqm(scores: Any, axis: int | None = None) -> Any:
    """Return the interquartile mean of `scores`, without the lowest and the highest quarter; nan if a score is nan."""
    xp = namespace_of(scores)
    scores = xp.asarray(scores)
    scores, position = (scores.ravel(), 0) if axis is None else (scores, axis % scores.ndim)
    low = scores.shape[position] // 4
    high = scores.shape[position] - low
    ordered = np.partition(scores, (low, high - 1), position) if xp is np else xp.sort(scores, position)
    middle = ordered[(*[slice(None)] * position, slice(low, high))]
    missing = xp.isnan(scores).any(axis=position)  # nan sorts last, so `middle` can lack it
    return xp.mean(middle, axis=position) + xp.where(missing, xp.nan, 0.0)


def bootstrap(scores: Any, statistic=iqm) -> tuple[Any, Any]:
    """Return the 95 % percentile interval of `statistic` over `scores [seeds, tasks]`, resampling seeds within each task.

    Scores of a single task can have the shape [seeds]. The interval is deterministic; it is nan for one seed.
    """
    xp = namespace_of(scores)
    table = xp.asarray(scores, float).reshape(len(scores), -1)
    tables = resampled(table, np.random.default_rng(0)).reshape(RESAMPLES, -1)
    return percentile_interval(statistic(tables, axis=1))


def resampled(scores: Any, rng: np.random.Generator) -> Any:
    """Return `RESAMPLES` resamples [R, N, tasks, ...] of `scores [N, tasks, ...]`; seeds are redrawn within each task.

    A single seed gives nan, because it does not show how seeds differ.
    """
    picks = rng.integers(len(scores), size=(RESAMPLES, *scores.shape[:2]))
    drawn = scores[picks, np.arange(scores.shape[1])]
    return drawn if len(scores) > 1 else drawn * np.nan


def summarise(scores: Any) -> Summary:
    """Return the `Summary` of `scores [seeds]`.

    Raises:
        ValueError: there are no scores, or one is not finite. The values of JAX arrays are not checked: NaN gives NaN.
    """
    xp = namespace_of(scores)
    scores = xp.asarray(scores, float)
    if scores.ndim != 1 or not len(scores) or (xp is np and not np.isfinite(scores).all()):
        raise InputError(f"expected finite scores of at least one seed, got {scores}")
    low, high = bootstrap(scores)
    return Summary(as_float(scores.mean()), as_float(stderr(scores)), as_float(iqm(scores)), low, high, len(scores))


def relative_drop(before: Any, after: Any) -> Estimate:
    """Return 1 - mean(`after`) / mean(`before`) of the same seeds, [seeds] each, with its bootstrap interval.

    Seeds are resampled in pairs. Resamples in which the mean of `before` is not positive are left out, and the result
    is nan if the mean of `before` itself is not positive. Source: Sharma et al. 2022, figure 4, the loss of success
    from starts that differ from those of training.

    Raises:
        ValueError: `before` and `after` have different numbers of seeds.
    """
    xp = namespace_of(before, after)
    before, after = xp.asarray(before, float), xp.asarray(after, float)
    if before.shape != after.shape:
        raise InputError(f"a drop compares the same seeds, but there are {len(before)} before and {len(after)} after")
    value = _drop(xp, before, after)
    if len(before) < 2:
        value = as_float(value)
        return Estimate(value, value * np.nan, value * np.nan)
    picks = np.random.default_rng(0).integers(len(before), size=(RESAMPLES, len(before)))
    drops = xp.where(xp.isnan(value), 0.0, _drop(xp, before[picks], after[picks]))
    low, high = xp.nanquantile(drops, np.array([0.025, 0.975])) + 0.0 * value  # nan if the value is
    return Estimate(as_float(value), as_float(low), as_float(high))


def _drop(xp: Any, before: Any, after: Any) -> Any:
    """Return the relative drops [...] of `before [..., seeds]` and `after`, nan where the mean of `before` is not positive."""
    mean = before.mean(axis=-1)
    return 1 - after.mean(axis=-1) / xp.where(mean > 0, mean, np.nan)


def percentile_interval(values: Any) -> tuple[Any, Any]:
    """Return the ends of the 95 % interval of resampled `values [R]`."""
    low, high = namespace_of(values).quantile(values, np.array([0.025, 0.975]))
    return as_float(low), as_float(high)
