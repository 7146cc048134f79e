"""The score of a run, which every command prints, and the paper's three scores of a whole lifetime.

Source of the three scores: Sharma et al. 2022, section 4.1: deployed and continuing policy evaluation.

Arguments are NumPy or JAX arrays, also inside `jit` and `vmap`, and results are of the same kind.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from earl_jax.errors import InputError, brief, require_known
from earl_jax.metrics.comparison import Sample, band, is_rounding, mean_interval
from earl_jax.metrics.continuing import DIVERGED, OVER
from earl_jax.metrics.deployed import WIDE
from earl_jax.metrics.phase_stats import ALIVE, BACK, FORWARD
from earl_jax.metrics.statistics import Estimate, namespace_of
from earl_jax.options.values import COUNT, counted, require

SHARE, FEWEST = 0.1, 5
"""A seed's score is its mean over the evaluations in this last share of a run, but over at least `FEWEST` of them."""
SUCCESS = "deployed/success"
CONTINUING = "continuing/reward"
RATES = frozenset({SUCCESS, WIDE, FORWARD, BACK, ALIVE, DIVERGED, OVER})
"""Metrics that are rates, from 0 to 1."""


def as_decimals(values: np.ndarray) -> np.ndarray:
    """Return the shortest decimals, as float64, that round to the float32 `values`; integers stay as they are.

    Means of equal shares are then equal, so that tests can count ties, and tables are a third smaller.
    """
    return values.astype(str).astype(float) if values.dtype.kind == "f" else values


@dataclasses.dataclass(frozen=True)
class Window:
    """The evaluations at the end of a run over which a seed is scored: its last tenth, and at least five of them.

    The `last` evaluations, or those of the last `steps` steps, replace the tenth. Giving both, or a number below 1,
    raises a ValueError, which uses the names of the command-line arguments `--last` and `--window`.
    """

    last: int | None = None
    steps: int | None = None

    def __post_init__(self) -> None:
        if self.last is not None and self.steps is not None:
            raise InputError("last counts evaluations and window counts steps: give one of them")
        for name, value in (("last", self.last), ("window", self.steps)):
            if value is not None:
                require(name, value, COUNT)

    def count(self, steps: np.ndarray) -> int:
        """Return how many of the evaluations at `steps [E]` count, at most E."""
        if self.last is not None:
            return min(self.last, len(steps))
        if self.steps is not None:
            return int((steps > steps[-1] - self.steps).sum())
        return min(len(steps), max(FEWEST, int((steps > (1 - SHARE) * steps[-1]).sum())))

    @property
    def text(self) -> str:
        """The evaluations that the score averages, in words, for a note below a table."""
        if self.last is not None:
            return "the last evaluation" if self.last == 1 else f"the last {self.last} evaluations"
        if self.steps is not None:
            return f"the evaluations of the last {self.steps:,} steps"
        return f"the evaluations of the last tenth of the run, at least {FEWEST}"


DEFAULT = Window()


def require_window(window: Any) -> None:
    """Raise an InputError if `window` is not a `Window`."""
    if not isinstance(window, Window):
        raise InputError(
            f"window must be an earl_jax.metrics.scores.Window, such as Window(last=5), not {brief(window)}"
        )


def final_scores(steps: np.ndarray, values: Any, window: Window = DEFAULT) -> Any:
    """Return the score [...] of each seed: the mean of `values [..., E]` over the evaluations of `window` at the end."""
    # By an index: a slice has another order in memory, and with it another last digit of the mean.
    return values[..., np.arange(-window.count(steps), 0)].mean(axis=-1)


def score_interval(scores: np.ndarray, metric: str, deployed: str) -> Estimate:
    """Return the mean of `scores [N]` of the seeds with its 95 % interval, within [0, 1] if the `metric` is a rate.

    For curves [N, E] it is the `band`. `deployed` is the task's deployed metric. The reward per step is a rate if the
    task's rewards are 0 and 1, but a life is not a trial: the ends are nan if all seeds agree.
    """
    if scores.ndim == 1 and metric.startswith("continuing/") and metric not in RATES:
        sample = Sample.of(scores)
        if is_rounding(sample.stderr**2, sample.mean):
            return Estimate(sample.mean, math.nan, math.nan)
    rewards = metric.startswith("continuing/re") and deployed == SUCCESS
    rate = metric in RATES or (rewards and bool(((scores >= 0) & (scores <= 1)).all()))
    return band(scores, rate) if scores.ndim > 1 else mean_interval(scores, rate)


class Score(NamedTuple):
    """The score of a run: the mean over seeds of `final_scores [N]` of a `metric`, with its 95 % interval `low` to `high`.

    `evaluations` is the number of evaluations that are averaged for each seed, from step `first` to step `last`. With
    fewer than three seeds, the ends of the interval are nan.
    """

    metric: str
    mean: float
    low: float
    high: float
    scores: tuple[float, ...]
    evaluations: int
    first: int
    last: int

    @classmethod
    def of(
        cls, steps: np.ndarray, metrics: dict[str, np.ndarray], metric: str, deployed: str, window: Window = DEFAULT
    ) -> "Score":
        """Return the score by `metric` of a run with the evaluations `steps [E]` and `metrics [N, E]`.

        `deployed` is the task's deployed metric.

        Raises:
            ValueError: there is no evaluation, or `window` is not a `Window`.
        """
        require_window(window)
        if not len(steps):
            raise InputError("there is no evaluation yet, so there is no score")
        scores, count = final_scores(steps, metrics[metric], window), window.count(steps)
        interval = score_interval(scores, metric, deployed)
        return cls(metric, *interval, tuple(scores.tolist()), count, int(steps[-count]), int(steps[-1]))

    def __str__(self) -> str:
        """Return the score in one line, with the seeds and evaluations that it averages."""
        interval = "" if np.isnan(self.low) else f" [{self.low:.3f}, {self.high:.3f}]"
        seeds = counted(len(self.scores), "seed")
        which = f"the evaluation at step {self.last:,}"
        if self.evaluations > 1:
            which = f"{self.evaluations} evaluations, steps {self.first:,} to {self.last:,}"
        return f"{self.metric} {self.mean:.3f}{interval}, mean of {seeds} over {which}"


class Scores(NamedTuple):
    """Scores of lifetimes, for example arrays [N] for N seeds.

    `final [...]`: J_D of the last policy. `deployed [...]`: the deployed curve averaged over the lifetime. `continuing
    [...]`: C(A), the task reward per step of the lifetime.
    """

    final: Any
    deployed: Any
    continuing: Any


def lifetime_scores(steps: Any, metrics: dict[str, Any], metric: str) -> Scores:
    """Return the scores of lives evaluated at `steps [E]`, from `metrics [..., E]`; `metric` names the deployed one."""
    for name in (metric, CONTINUING):
        require_known("metric", name, metrics)
    scores = metrics[metric]
    return Scores(scores[..., -1], deployed_area(steps, scores), metrics[CONTINUING][..., -1])


def deployed_area(steps: Any, scores: Any) -> Any:
    """Return the area per step [...] under deployed curves `scores [..., E]`.

    Each evaluation is weighted by the steps since the previous one. The paper sums J_D(pi_t) over every t, which would
    need an evaluation at every step.

    Raises:
        ValueError: the number of `steps` differs from the number of scores in a curve, or (of NumPy arrays) there are
            none, or they do not ascend.
    """
    if np.shape(steps) != np.shape(scores)[-1:]:
        raise InputError(f"steps {np.shape(steps)} and scores {np.shape(scores)} do not belong to the same evaluations")
    since = namespace_of(steps).diff(steps, prepend=0)
    if namespace_of(since) is np and not (len(since) and (since > 0).all()):
        raise InputError(f"steps must be at least one evaluation in ascending order, not {brief(steps)}")
    return (scores * since).sum(axis=-1) / steps[-1]


def regret(steps: Any, scores: Any, best: float) -> Any:
    """Return the paper's D(A) [...]: the sum of J_D(pi*) - J_D(pi_t) over all steps; `best` is J_D(pi*)."""
    return (best - deployed_area(steps, scores)) * steps[-1]
