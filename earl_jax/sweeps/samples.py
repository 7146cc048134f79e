"""Samples of options in a sweep file: random or Sobol points, mapped to intervals and choices. It imports no learner.

Source: Bergstra and Bengio 2012, "Random search for hyper-parameter optimization"; Sobol's sequence with Owen's scrambling is
SciPy's.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

from earl_jax.errors import InputError

SAMPLERS = ("random", "sobol")
DIGITS = 4
"""Significant digits of a sampled float, so that the name of its run has the exact value."""
MOST_SAMPLES = 10_000
Point = float
"""A number in [0, 1)."""


def is_distribution(value: Any) -> bool:
    """Return whether the value of an option is a distribution, such as `{ log_uniform = [1e-5, 1e-2] }`."""
    return isinstance(value, dict)


def samples(
    distributions: Mapping[str, dict[str, Any]], count: int, sampler: str = "random", seed: int = 0
) -> list[dict[str, Any]]:
    """Return `count` settings of the options in `distributions`.

    The first n settings are the same for every `count` of at least n. Floats have four significant digits.

    Raises:
        ValueError: a distribution, `count`, `sampler` or `seed` is invalid; the message names the option.
    """
    if sampler not in SAMPLERS:
        raise InputError(f"unknown sampler {sampler!r}; choose from {', '.join(SAMPLERS)}")
    for name, value, low, high in (("samples", count, 1, MOST_SAMPLES), ("sample_seed", seed, 0, 2**32 - 1)):
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise InputError(f"{name} must be a whole number from {low} to {high}, not {value!r}")
    names = sorted(distributions)
    mappings = [mapping(name, distributions[name]) for name in names]
    points = _points(count, len(names), sampler, seed)
    return [{name: map_(u) for name, map_, u in zip(names, mappings, row, strict=True)} for row in points]


def mapping(option: str, distribution: dict[str, Any]) -> Callable[[Point], Any]:
    """Return the function from [0, 1) to values of `option`: the quantiles of its distribution.

    Raises:
        ValueError: `distribution` is not one of `uniform`, `log_uniform`, `integers` with two ends, or `choice` of a list.
    """
    kind, ends = next(iter(distribution.items())) if len(distribution) == 1 else ("", None)
    if kind not in KINDS:
        raise InputError(
            f"option {option} = {distribution} must be one of {', '.join(KINDS)}, as in {{ log_uniform = [1e-5, 1e-2] }}"
        )
    if not isinstance(ends, list) or not ends or (kind != "choice" and not _are_ends(kind, ends)):
        wanted = "a list of values" if kind == "choice" else "two numbers, the smaller one first"
        positive = ", both above 0" if kind == "log_uniform" else ""
        whole = ", both whole" if kind == "integers" else ""
        raise InputError(f"option {option}: {kind} takes {wanted}{positive}{whole}, not {ends}")
    return KINDS[kind](ends)


def _are_ends(kind: str, ends: list[Any]) -> bool:
    types = (int,) if kind == "integers" else (int, float)
    if len(ends) != 2 or not all(type(end) in types and math.isfinite(end) for end in ends):
        return False
    return ends[0] < ends[1] and (kind != "log_uniform" or ends[0] > 0)


def _uniform(ends: list[float]) -> Callable[[Point], float]:
    low, high = map(float, ends)
    return lambda u: rounded(low + u * (high - low), low, high)


def _log_uniform(ends: list[float]) -> Callable[[Point], float]:
    low, high = map(float, ends)
    return lambda u: rounded(low * (high / low) ** u, low, high)


def _integers(ends: list[int]) -> Callable[[Point], int]:
    low, high = ends
    return lambda u: low + int(u * (high - low + 1))


def _choice(values: list[Any]) -> Callable[[Point], Any]:
    return lambda u: values[int(u * len(values))]


KINDS = {"uniform": _uniform, "log_uniform": _log_uniform, "integers": _integers, "choice": _choice}
"""Distributions by name; each makes the quantile function of its list."""


def rounded(value: float, low: float, high: float) -> float:
    """Return `value` with four significant digits, still between `low` and `high`."""
    return min(max(float(f"{value:.{DIGITS}g}"), low), high)


def _points(count: int, size: int, sampler: str, seed: int) -> list[list[Point]]:
    """Return `count` points in [0, 1)^`size`."""
    if sampler == "sobol":
        from scipy.stats import qmc  # it takes a second

        # A whole power of two: the balance of Sobol's sequence holds for those.
        return qmc.Sobol(size, rng=seed).random_base2(math.ceil(math.log2(count)))[:count].tolist()
    import numpy as np

    return np.random.default_rng(seed).random((count, size)).tolist()
