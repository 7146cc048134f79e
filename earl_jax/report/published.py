"""The published numbers and the released runs of the paper.

Source: Sharma et al. 2022, tables 1 and 2; `steps` comes from the released configurations.
"""

import dataclasses
import math
from decimal import Decimal
from typing import NamedTuple

from earl_jax import assets
from earl_jax.algos.method import kept_transitions
from earl_jax.envs import PAPER_TASKS, make
from earl_jax.errors import InputError
from earl_jax.metrics.comparison import Sample, error_interval
from earl_jax.metrics.scores import CONTINUING, DEFAULT, as_decimals
from earl_jax.metrics.statistics import STDERR_RULE
from earl_jax.options.schedule import Schedule
from earl_jax.report.runs import Curves
from earl_jax.runs.config import RunConfig

SEEDS = 5
"""Number of seeds of each published score."""
TEST_RULE = (
    "Tests against the paper: the permutation test of our seeds and the five released ones, over the same steps, up to the last "
    "step that both have. Where no runs were released (Minitaur), Welch's test of runs of the published length against the "
    "printed mean and standard error, which divides by n and is converted; one printed as 0.00 counts as half a unit of its last "
    "digit. Defaults that were chosen with a look at runs of the same tasks (the reward scale of 10, the phases of FBRL, the "
    "subgoals of VaPRL, the replay of runs that are longer than it) are favoured by them."
)
FAMILY_RULE = (
    "p is adjusted by Holm over a family: the tests that answer one question on one task, here {family}. The verdict is above or "
    "below if the adjusted p is under 0.05, else `cannot tell`, with the detectable difference, which Welch's test "
    "would find with a probability of 80 % without the adjustment."
)
INTERVAL_RULE = (
    f"{TEST_RULE} Table 1 is tested by scores of seeds, means over {DEFAULT.text}; the printed numbers are of the last "
    f"evaluation. {FAMILY_RULE.format(family='the methods against the paper')} The verdict is `-` if nothing is published or "
    f"nothing was run. Intervals of 95 % are Student's, or Wilson's for rates. Standard error: {STDERR_RULE}."
)

RECONSTRUCTED = ("dhand_lightbulb",)
"""Tasks of the paper that were never released: ours are other tasks, so no published score stands beside their runs."""

CHOSEN = {
    "reward_scale": "reward scale", "fixed_phases": "phases", "nearest_fallback": "subgoals", "unmet_goals": "subgoals",
    "replay_capacity": "replay",
}  # fmt: skip
"""Options whose defaults were chosen with a look at runs of the paper's tasks, and their words. Of the reward scale it is that
of sparse tasks, of the replay that of runs in which it evicts transitions."""
OWN, UNREWARDED = "cfbrl", "bc"
"""The method that was developed on these tasks, of which all options were chosen so, and one that learns from no reward."""


def chosen_words(curves: Curves) -> str:
    """Return which settings of a run were chosen with a look at runs of the same tasks, which favours them; `-` for none."""
    config = curves.config
    if config.algo in (OWN, UNREWARDED) or config.env not in PAPER_TASKS:
        return "all options" if config.algo == OWN else "-"
    try:
        method = config.build_method()
    except InputError:  # its class is not registered here, or its options are not those of this version
        return "-"
    fields = {field.name for part in (method, method.learner) for field in dataclasses.fields(part)}
    unused = set(config.options)
    if not make(config.env).sparse:
        unused |= {"reward_scale"}
    if config.steps <= (kept_transitions(method) or math.inf):
        unused |= {"replay_capacity"}
    words = [CHOSEN[name] for name in CHOSEN if name in fields - unused]
    return ", ".join(dict.fromkeys(words)) or "-"


class PublishedScore(NamedTuple):
    """A score as the paper prints it: texts such as `0.94`, `<0.001` or `-`."""

    mean: str
    stderr: str

    @property
    def value(self) -> float:
        """The mean as a number; `<x` counts as x."""
        return float(self.mean.lstrip("<"))

    @property
    def text(self) -> str:
        """The mean, with the standard error in brackets if one is printed."""
        return self.mean + ("" if self.stderr == "-" else f" ({self.stderr})")

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the mean, half a unit of its last digit wider; `<x`, which has no error, gives 0 to x.

        It is Student's, or within [0, 1] Wilson's: all published rates are there, and no return is.
        """
        sample = self.sample
        if sample is None:
            return 0.0, self.value
        rounding, rate = _half_unit(self.mean), 0 <= sample.mean <= 1
        error = 0.0 if rate and not float(self.stderr) else sample.stderr
        low, high = error_interval(sample.mean, error, SEEDS, rate)
        low, high = float(low) - rounding, float(high) + rounding
        return (max(0.0, low), min(1.0, high)) if rate else (low, high)

    @property
    def sample(self) -> Sample | None:
        """The five seeds as mean and standard error with n - 1; None if no standard error is printed.

        The paper divides by n. An error that is printed as 0 counts as half a unit of its last digit.
        """
        if self.stderr == "-":
            return None
        error = max(float(self.stderr), _half_unit(self.stderr)) * math.sqrt(SEEDS / (SEEDS - 1))
        return Sample(float(self.mean), error, SEEDS)


def _half_unit(number: str) -> float:
    """Return half a unit of the last digit of a printed number."""
    return 0.5 * 10.0 ** int(Decimal(number).as_tuple().exponent)


def published_score(number: int, env: str, algo: str) -> PublishedScore | None:
    """Return the score of a method on a task in table `number` (1 or 2), or None if the paper has none."""
    row = assets.published_row(f"table{number}", env=env, algo=algo)
    return PublishedScore(row["mean"], row["stderr"]) if row else None


def released_curves(env: str, algo: str) -> Curves | None:
    """Return the released runs of the paper of a method on a task, or None if there are none."""
    runs = assets.released_runs(env, algo)
    if not runs:
        return None
    steps = runs["steps"]
    schedule = Schedule(steps=int(steps[-1]), eval_every=int(steps[1] - steps[0]), checkpoint_every=int(steps[-1]))
    lengths = dataclasses.asdict(schedule)
    config = RunConfig(env, {}, algo, {}, tuple(range(SEEDS)), **lengths, reward_type=make(env).reward_type)
    names = {"deployed": config.deployed_metric, "continuing": CONTINUING}
    return Curves(config, steps, {names[name]: as_decimals(runs[name]) for name in names if name in runs})


def released_beside(curves: Curves) -> Curves | None:
    """Return the released runs of the paper to set beside a run; None if there are none, or it is not comparable."""
    released = released_curves(curves.env, curves.algo) if is_comparable(curves) else None
    return released and released._replace(window=curves.window)


def is_comparable(curves: Curves) -> bool:
    """Return whether published numbers may stand beside a run: its task, kind of reward and setting are the paper's."""
    return curves.env not in RECONSTRUCTED and curves.comparable


def published_beside(number: int, curves: Curves) -> PublishedScore | None:
    """Return the score to set beside a run in table `number`, None if there is none or it is not comparable."""
    return published_score(number, curves.env, curves.algo) if is_comparable(curves) else None


def published_steps(env: str) -> tuple[int, int] | None:
    """Return the least and the greatest length of the paper's runs on a task, or None if unpublished."""
    row = assets.published_row("steps", env=env)
    return (int(row["low"]), int(row["high"])) if row else None


def training_steps(env: str) -> int:
    """Return the steps that the paper trained for on one of `PAPER_TASKS`, the least where its runs differ."""
    steps = published_steps(env)
    if steps is None:
        raise InputError(f"no number of steps is published for {env!r}; choose from {', '.join(PAPER_TASKS)}")
    return steps[0]


def share_text(steps: int, published: int) -> str:
    """Return the share that `steps` have of more `published` ones, such as `12 %`; at most 99 %."""
    return f"{min(100 * steps / published, 99):.2g} %"


def published_fault(number: int, env: str) -> str | None:
    """Return the known faults of the published scores of a task in table `number`, or None if there are none."""
    rows = [row for row in assets.published("faults") if (row["paper_table"], row["env"]) == (f"table{number}", env)]
    return " ".join(row["fault"] for row in rows) or None
