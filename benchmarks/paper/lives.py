"""What the rewards of some lives look like beside the released ones: `python -m benchmarks.paper.lives`.

Writes results/paper/lives_measures.{csv,md}: one number of each seed over the steps that both sides have, and the permutation
test, p not adjusted. The measures were chosen after a look at the curves, so they describe a difference and confirm nothing.
"""

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.output import write_files
from benchmarks.paper.cells import RUNS
from earl_jax.envs.kitchen.franka_kitchen import FrankaKitchen
from earl_jax.metrics.comparison import permutation
from earl_jax.metrics.scores import CONTINUING
from earl_jax.report.published import released_curves
from earl_jax.report.runs import Curves, common_step, read
from earl_jax.report.tables import Row, csv_text, markdown_table, millions, number_text

SHUT = 0.99
"""The reward per step from which a door counts as shut all the time."""
EARLY = 300_000
"""The steps after which the doors of the two sides differ, and at which the kitchens already do."""
LONG = 20_000
"""Steps of the intervals of the kitchen's lives: the rows of R3L's released ones."""
RESETS = FrankaKitchen.train_horizon
"""Steps between two resets of the kitchen."""
STILL = 0.1
"""The change of the reward per step under which a kitchen counts as still."""
KITCHEN_NAIVE, KITCHEN_FBRL, KITCHEN_R3L = (
    f"franka_kitchen/{run}" for run in ("naive/replay_capacity_None", "fbrl/commit_c7e2d9e", "r3l/commit_c7e2d9e")
)
"""The kitchen's runs that have an evaluation every `LONG` steps."""
TASK_REWARD = "phase_reward_r3l/task_reward"
"""The metric of phase_rewards.py: the mean reward in the task controller's replay."""
WHOLE_REPLAY = 2_000_000
"""The steps after which the replay of a controller, which takes half of them, begins to lose some."""
HEADER = "run", "measure of a seed", "steps", "ours", "published", "p", "our seeds", "published seeds"


def shut_share(curves: Curves) -> np.ndarray:
    """Return the share [N] of the intervals between evaluations, after `EARLY` steps, with the door shut all the time."""
    return (_rates(curves)[:, curves.steps[1:] > EARLY] >= SHUT).mean(axis=1)


def memory(curves: Curves) -> np.ndarray:
    """Return the correlation [N] of the rewards of an interval of `LONG` steps and of the next one."""
    _, means = _long_rates(curves)
    return np.array([np.corrcoef(life[:-1], life[1:])[0, 1] for life in means])


def still_share(curves: Curves) -> np.ndarray:
    """Return the share [N] of the intervals of `LONG` steps that earn within `STILL` of the one before."""
    return (np.abs(np.diff(_long_rates(curves)[1], axis=1)) < STILL).mean(axis=1)


def beside_reset(curves: Curves, end: int) -> np.ndarray:
    """Return the reward [N] per step of the `LONG` steps up to `end` steps after a reset of the kitchen, 0 for before it."""
    ends, means = _long_rates(curves)
    return means[:, ends % RESETS == end].mean(axis=1)


def after_reset_or_all(curves: Curves) -> np.ndarray:
    """Return `beside_reset` [N] of our runs, and of the released ones the reward per step of all: these may have more resets."""
    return beside_reset(curves, LONG) if curves.runs else reward(curves)


def task_controller(curves: Curves) -> np.ndarray:
    """Return the mean reward [N] of our task controllers' steps up to `WHOLE_REPLAY`, and of the released lives that of all."""
    return _last(curves, TASK_REWARD if curves.runs else CONTINUING, WHOLE_REPLAY)


def _long_rates(curves: Curves) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends [I] of the last intervals of `LONG` steps, and their rewards per step [N, I]."""
    rates, rows = _rates(curves), LONG // curves.config.schedule.eval_every
    whole = rates.shape[1] // rows * rows
    return curves.steps[-whole:][rows - 1 :: rows], rates[:, -whole:].reshape(len(rates), -1, rows).mean(axis=2)


def reward(curves: Curves, end: float = np.inf) -> np.ndarray:
    """Return the reward [N] per step of the life, up to `end` steps."""
    return _last(curves, CONTINUING, end)


def _last(curves: Curves, name: str, end: float) -> np.ndarray:
    """Return the metric `name` [N] at the last evaluation up to `end` steps."""
    return curves.metrics[name][:, curves.steps <= end][:, -1]


def _rates(curves: Curves) -> np.ndarray:
    """Return the rewards per step [N, E - 1] of the intervals between the evaluations."""
    return np.diff(curves.metrics[CONTINUING] * curves.steps) / np.diff(curves.steps)


Measure = Callable[[Curves], np.ndarray]
AFTER_RESET = "reward per step of the 20,000 after a reset", functools.partial(beside_reset, end=LONG)
MEASURES: tuple[tuple[str, str, Measure], ...] = (
    *(
        (f"sawyer_door/vaprl{variant}", "share of intervals after 0.3M steps with the door shut", shut_share)
        for variant in ("", "/dual", "/dual_demos", "/dual_demos-seeds_10_to_14")
    ),
    *(
        (f"franka_kitchen/{algo}", "reward per step up to 0.3M steps", functools.partial(reward, end=EARLY))
        for algo in ("naive", "fbrl", "fbrl/released", "naive/released", "r3l/released", "r3l/released_resets")
    ),
    ("franka_kitchen/fbrl/random_10000", *AFTER_RESET),  # it ends at 0.3M
    *(
        (run, "correlation of successive intervals of 20,000 steps", memory)
        for run in (KITCHEN_FBRL, KITCHEN_R3L, "franka_kitchen/r3l/released_resets")
    ),
    *(
        (run, "reward per step of the 20,000 after a reset, the paper's of all steps", after_reset_or_all)
        for run in (KITCHEN_R3L, "franka_kitchen/r3l/released")
    ),
    *(
        (run, name, measure)
        for run in (
            KITCHEN_NAIVE,
            KITCHEN_FBRL,
            "franka_kitchen/fbrl/mean_return",
            "franka_kitchen/fbrl/released",
            "franka_kitchen/naive/released",
        )
        for name, measure in (
            AFTER_RESET,
            ("reward per step of the 20,000 before a reset", functools.partial(beside_reset, end=0)),
            ("share of intervals of 20,000 steps like the one before", still_share),
        )
    ),
    ("tabletop_organization/r3l/error_scale", "reward per step", reward),
    ("tabletop_organization/r3l/object_novelty", "reward per step", reward),
    ("tabletop_organization/r3l/perturbation_demos", "reward per step", reward),
    ("tabletop_organization/r3l/timeout_bootstrap", "reward per step", reward),
    ("franka_kitchen/r3l/released_resets", "reward per step", reward),
    ("franka_kitchen/r3l/phase_rewards", "reward per step", reward),
    ("franka_kitchen/r3l/phase_rewards", "reward per step up to 2M steps", functools.partial(reward, end=WHOLE_REPLAY)),
    (
        "franka_kitchen/r3l/phase_rewards",
        "reward per step of the task controller up to 2M, the paper's of all",
        task_controller,
    ),
)
STYLES = {"share": ".2f", "correlation": ".2f", "reward": ".3g"}
"""The format of a measure's numbers by its first word."""


def measured(run: str, name: str, measure: Measure) -> Row:
    """Return the row of a `run` below results/paper and its released counterpart."""
    env, algo = run.split("/")[:2]
    ours, released = read(RUNS / run), released_curves(env, algo)
    assert released is not None
    first, last = max(ours.steps[0], released.steps[0]), common_step(ours, released)
    assert last is not None
    own, other = (measure(_between(curves, first, last)) for curves in (ours, released))
    return {
        "run": run, "measure": name, "steps": last, "mean": own.mean(), "published": other.mean(),
        "p": permutation(own, other).p, "seeds": own.tolist(), "published_seeds": other.tolist(),
    }  # fmt: skip


def _between(curves: Curves, first: int, last: int) -> Curves:
    """Return the evaluations from the step `first` to `last`, both included."""
    kept = (curves.steps >= first) & (curves.steps <= last)
    wanted = {CONTINUING, curves.deployed_metric, TASK_REWARD}
    metrics = {name: values[:, kept] for name, values in curves.metrics.items() if name in wanted}
    return curves._replace(steps=curves.steps[kept], metrics=metrics)


def files() -> dict[Path, str]:
    """Return the rows as files."""
    rows = [measured(*entry) for entry in MEASURES]
    path = RUNS / "lives_measures"
    return {
        path.with_suffix(".csv"): csv_text(rows),
        path.with_suffix(".md"): markdown_table(HEADER, map(_line, rows)) + "\n",
    }


def _line(row: Row) -> list[str]:
    style = STYLES[row["measure"].split()[0]]
    own, other = ("; ".join(number_text(value, style) for value in row[side]) for side in ("seeds", "published_seeds"))
    means = [number_text(row[side], style) for side in ("mean", "published")]
    return [row["run"], row["measure"], millions(row["steps"]), *means, f"{row['p']:.2g}", own, other]


if __name__ == "__main__":
    write_files(files())
