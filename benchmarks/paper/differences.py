"""The differences that could separate our runs from the published ones, and how each is settled by the runs at hand.

    python -m benchmarks.paper.differences

Each difference has tests of two sets of runs in results/paper: `earl-jax compare`'s permutation test at the last step that
both have. A family for Holm's adjustment has the tests of a difference on a task, at all ages. A test without its runs is not
made, and the table says `not run`. Writes results/paper/{pairs.csv,pairs.md}, the figure of the cheetah and the table
`differences` of the pages.
"""

import dataclasses
import itertools
from pathlib import Path

import numpy as np

from benchmarks.output import write_files
from benchmarks.paper.cells import FORMER_VAPRL, NOT_RUN, PEG, RUNS, TABLETOP, cells, paper_tests, read_runs
from benchmarks.paper.uniform_starts import RELEASED, SEEDS, read_seeds
from earl_jax.envs import make
from earl_jax.errors import InputError
from earl_jax.metrics.comparison import CANNOT_TELL, mean_interval
from earl_jax.metrics.scores import SUCCESS
from earl_jax.paper.artefact import training_steps
from earl_jax.report.comparison import comparison_columns, pair_row, published_rows, verdict_text, with_verdicts
from earl_jax.report.paper_rows import CONTINUING
from earl_jax.report.plots import plot_runs
from earl_jax.report.pooling import read_all
from earl_jax.report.runs import MethodRuns
from earl_jax.report.tables import Row, csv_text, interval_text, markdown_table, millions, number_text

DOOR, KITCHEN, MINITAUR, CHEETAH = "sawyer_door", "franka_kitchen", "minitaur_pen", "cheetah_run"
HEADER = ("#", "ours, and what may differ", "first", "second", "steps", "first, mean [95 %]", "second, mean",
          "difference [95 %]", "p", "adjusted p", "settled")  # fmt: skip

DEPLOYED = "deployed"
"""The metric of a pair that names none: success or return."""
LEAST = 0.001
"""The least p that is printed as a number."""
FAMILY = (
    "In this table a family has the tests of one difference on a task, at all ages: those between our runs, or those with the "
    "released runs."
)
PUBLISHED = ("published",)
"""The second side of a pair that tests ours against the released runs."""


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two sets of run folders below results/paper that differ in one thing; the seeds of a set are pooled.

    They are compared by the `metric`, by default the deployed score. The second set may be `PUBLISHED`.
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    metric: str | None = None


@dataclasses.dataclass(frozen=True)
class Difference:
    """A difference `what` with its number in the review, the `pairs` that test it, and a `cell` that was to be run.

    Two differences that the same pair tests have a number of both.
    """

    number: str
    what: str
    pairs: tuple[Pair, ...] = ()
    cell: tuple[str, str] | None = None


BIASED = f"{CHEETAH}/naive/train_horizon_1000"
BOOTSTRAPPED = f"{CHEETAH}/naive/timeout_bootstrap-train_horizon_1000"
SHORTER = f"{CHEETAH}/naive/discount_0.98901-timeout_bootstrap-train_horizon_1000"
CAPACITY = "replay_capacity_1000000"
RELEASED_REPLAY = f"keep_demos_False-{CAPACITY}"
SCRIPT_OPTIONS = f"random_steps_10000-{CAPACITY}-reward_scale_0.1"
HORIZONS = 1_000, 10_000, 200_000


def _released(update: str, horizon: int) -> tuple[str, str]:
    """Return the run of the released script with an `update` and its further seeds, which trained longer."""
    name = f"{CHEETAH}/naive/{SCRIPT_OPTIONS}{update}-train_horizon_{horizon}"
    return name, f"{name}-seeds_5_to_9"


def _replays(cell: str) -> tuple[Pair, ...]:
    """Return the tests of a cell's replay: every step, or the last 1,000,000, with the demonstrations or without them."""
    released = f"{cell}/{RELEASED_REPLAY}"
    sides = ((cell,), (f"{cell}/{CAPACITY}",)), ((cell,), (released,)), ((released,), PUBLISHED)
    return tuple(Pair(*pair, metric) for pair in sides for metric in (None, CONTINUING))


RELEASED_BIASED, RELEASED_BOOTSTRAPPED = (
    tuple(_released(update, horizon) for horizon in HORIZONS) for update in ("", "-timeout_bootstrap")
)
ORACLE = (f"{PEG}/oracle", f"{PEG}/oracle/seeds_5_to_14")
AGAIN = {
    cell: f"{cell}/commit_{commit}"
    for cell, commit in (
        (f"{TABLETOP}/fbrl", "438fb6a"), (f"{TABLETOP}/oracle", "438fb6a"), (f"{DOOR}/r3l", "45e2f6a"),
        (f"{KITCHEN}/naive", "87f9604"), (f"{KITCHEN}/oracle", "87f9604"),
    )
}  # fmt: skip
"""Cells whose seeds were run again, and their earlier runs."""
VAPRL = {
    DOOR: ("vaprl/no_nearest_fallback", "vaprl/no_unmet_goals", "vaprl"),
    TABLETOP: ("vaprl/no_unmet_goals", "vaprl"),
}
DIFFERENCES = (
    Difference("1", "FBRL from uniform starts: two controllers, or one agent for both directions"),
    Difference("2", "figure 2 with the release's script: reward scale 0.1, 10,000 random steps; the biased update", tuple(
        Pair(biased[seeds], bootstrapped[seeds])
        for seeds in (slice(None), slice(1, None))
        for biased, bootstrapped in zip(RELEASED_BIASED, RELEASED_BOOTSTRAPPED, strict=True)
    )),
    Difference("3", "the biased update at H_T = 1,000: the effective discount 0.98901, or rare large targets", (
        Pair((SHORTER,), (BIASED,)), Pair((SHORTER,), (BOOTSTRAPPED,)),
    )),
    Difference("4", "the peg's oracle without layer norm: reward scale, layer norm", (
        Pair((f"{PEG}/oracle/scale_10-seeds_20_to_29",), (f"{PEG}/oracle/scale_1-seeds_20_to_29",)),
        Pair(ORACLE[:1], (f"{PEG}/oracle/reward_scale_1",)), Pair(ORACLE[1:], (f"{PEG}/oracle/layer_norm",)),
    )),
    Difference("5, 6", "VaPRL as it was: new goals that are met already, and the highest value where none reaches epsilon", tuple(
        Pair((f"{env}/vaprl/{FORMER_VAPRL}",), (f"{env}/{name}",)) for env, names in VAPRL.items() for name in names
    )),
    Difference("7", "VaPRL on the door with the final model", cell=(DOOR, "vaprl")),
    Difference("8", "naive RL's goal for 1,000 steps; the release: 400, after 10,000 random steps", tuple(
        Pair((f"{TABLETOP}/naive",), (f"{TABLETOP}/naive/{name}",)) for name in ("episode_200", "episode_400", "random_10000")
    )),
    Difference("9", "FBRL in bf16, or in tf32", (Pair((f"{TABLETOP}/fbrl",), (f"{TABLETOP}/fbrl/tf32",)),)),
    Difference("10", "our demonstrations, or the authors' recordings", tuple(
        Pair((f"{env}/{algo}{ours}",), (f"{env}/{algo}/demo_file_recorded{recorded}",))
        for env in (TABLETOP, DOOR, PEG)
        for algo, ours, recorded in (("vaprl", f"/{FORMER_VAPRL}", f"-{FORMER_VAPRL}"), ("fbrl", "", ""))
    )),
    Difference("11", "naive RL on the door: a goal for 1,000 steps; the release: 400, after 10,000 random steps; its replay", (
        Pair((f"{DOOR}/naive",), (f"{DOOR}/naive/episode_400-random_10000",)),
        *_replays(f"{DOOR}/naive"),
    )),
    Difference("12", "R3L's life on tabletop: terminal time-outs; the novelty's scale; no demonstrations to perturb with", tuple(
        Pair((f"{TABLETOP}/r3l",), tuple(f"{TABLETOP}/r3l/{name}" for name in names), CONTINUING)
        for names in (("timeout_bootstrap",), ("error_scale", "error_scale-seeds_5_to_9"), ("perturbation_demos",))
    )),
    Difference("13", "the kitchen's life: light's weight; reward scale 1, 0.1, 10; 10,000 random steps; float32; entropy", (
        *(Pair((f"{KITCHEN}/{algo}",), (f"{KITCHEN}/{algo}/unweighted_light",), CONTINUING) for algo in ("fbrl", "r3l")),
        *(
            Pair((f"{KITCHEN}/{algo}/unweighted_light",), (f"{KITCHEN}/{algo}/reward_scale_{scale}",), CONTINUING)
            for scale in ("0.1", "10") for algo in ("fbrl", "r3l")
        ),
        *(
            Pair((f"{KITCHEN}/fbrl",), (f"{KITCHEN}/fbrl/{name}",), CONTINUING)
            for name in ("random_10000", "precision_float32", "entropy_per_action_-1")
        ),
    )),
    Difference("14", "VaPRL's life on the door: the release's replay", _replays(f"{DOOR}/vaprl")),
    Difference("15", "the Minitaur's oracle and R3L: reward scale 1; ends at success; no randomisation; the paper's reward", (
        *(
            Pair((f"{MINITAUR}/{algo}",), (f"{MINITAUR}/{algo}/{name}",))
            for name in ("reward_scale_1", "terminate_on_success") for algo in ("oracle", "r3l")
        ),
        Pair((f"{MINITAUR}/oracle",), (f"{MINITAUR}/oracle/terminate_on_success",), SUCCESS),
        *(
            Pair((f"{MINITAUR}/oracle",), (f"{MINITAUR}/oracle/{name}",))
            for name in ("no_randomize", "no_randomize-reward_scale_1")
        ),
        Pair((f"{MINITAUR}/oracle",), (f"{MINITAUR}/oracle/variant_paper",), SUCCESS),
    )),
    Difference("16", "the kitchen's oracle, both of its runs: the light's weight; the release's reward scale 0.1", (
        *(
            Pair((f"{KITCHEN}/oracle", AGAIN[f"{KITCHEN}/oracle"]), (f"{KITCHEN}/oracle/{name}",))
            for name in ("unweighted_light", "reward_scale_0.1")
        ),
        Pair((f"{KITCHEN}/oracle/reward_scale_0.1",), PUBLISHED),
    )),
    Difference("17", "the same seeds again: the kept run, or an earlier one", tuple(
        Pair((cell,), (earlier,)) for cell, earlier in AGAIN.items()
    )),
    Difference("18", "VaPRL outperforms the oracle and R3L: with both of their runs", tuple(
        Pair((f"{env}/vaprl",), (cell, AGAIN[cell])) for env, cell in ((TABLETOP, f"{TABLETOP}/oracle"), (DOOR, f"{DOOR}/r3l"))
    )),
)  # fmt: skip


def comparisons(root: Path = RUNS, seeds: Path = SEEDS) -> list[Row]:
    """Return the rows of all tests whose runs are there, each with the `number` of its difference, its family for Holm."""
    rows = [{"number": "1", "metric": DEPLOYED, **row} for row in starts_rows(read_seeds(seeds))]
    for entry in DIFFERENCES:
        tested = [(pair.metric, row) for pair in entry.pairs if (row := _pair_row(root, pair))]
        rows += [{"number": entry.number, "metric": metric or DEPLOYED, **row} for metric, row in tested]
    rows = [{**row, "released": row["second"] == PUBLISHED[0]} for row in rows]
    return with_verdicts(rows, family=("number", "env", "released"))


def starts_rows(runs: dict[str, dict[str, np.ndarray]]) -> list[Row]:
    """Return the tests of FBRL with two controllers and with one: success from uniform starts, and the loss to it."""
    if not {"fbrl", "fbrl/controllers_1"} <= runs.keys():
        return []
    two, one = runs["fbrl"], runs["fbrl/controllers_1"]
    losses = [success["initial"] - success[RELEASED] for success in (two, one)]
    return [
        _scores_row("success from starts within 2.5", two[RELEASED], one[RELEASED]),
        _scores_row("success from s0 minus that", *losses),
    ]


def _scores_row(measure: str, scores: np.ndarray, others: np.ndarray) -> Row:
    own, test = mean_interval(scores, rate=bool((scores >= 0).all())), comparison_columns(scores, others)
    return {
        "env": TABLETOP, "first": f"fbrl, {measure}", "second": "fbrl/controllers_1", "steps": training_steps(TABLETOP),
        "seeds": len(scores), "other_seeds": len(others), "mean": own.value, "mean_low": own.low, "mean_high": own.high,
        **test, "mean_over": "episodes from such starts",
    }  # fmt: skip


def _pair_row(root: Path, pair: Pair) -> Row | None:
    """Return the test of a pair, or None if a side has no run; further folders of a side may be missing."""
    first = _pooled(root, pair.first)
    if first and pair.second == PUBLISHED:
        return published_rows([first], pair.metric)[-1]
    second = _pooled(root, pair.second)
    return pair_row(first, second, pair.metric) if first and second else None


def _pooled(root: Path, names: tuple[str, ...]) -> MethodRuns | None:
    """Return the pooled seeds of those of the folders that have a run."""
    folders = [root / name for name in names if (root / name / "metrics.csv").is_file()]
    if not folders:
        return None
    groups = read_all(folders)
    if len(groups) > 1:
        raise InputError(f"{', '.join(map(str, folders))} differ in their options, so their seeds cannot be pooled")
    env, label = folders[0].relative_to(root).as_posix().split("/", 1)
    return MethodRuns(env, groups[0].config.algo, label, groups[0])


def table(rows: list[Row], own_cells: list[Row]) -> str:
    """Return the table of the differences from the rows of `comparisons` and those of the paper's cells."""
    lines = []
    for entry in DIFFERENCES:
        tested = [_line(row) for row in rows if row["number"] == entry.number]
        tested += [_cell_line(row) for row in own_cells if (row["env"], row["algo"]) == entry.cell and row["seeds"]]
        lines += [[entry.number, entry.what, *line] for line in tested or [["-"] * 8 + [NOT_RUN]]]
    for previous, line in reversed(list(itertools.pairwise(lines))):
        line[:2] = ["", "the same"] if previous[0] == line[0] else line[:2]
    return markdown_table(HEADER, lines)


def _line(row: Row) -> list[str]:
    verdict = verdict_text(row, lambda value: _number(row, value))
    settled = verdict if verdict.startswith(CANNOT_TELL) else f"the first is {verdict}"
    first, second = (_short(row[side]) for side in ("first", "second"))
    return [
        f"{row['env']} {first}, {row['seeds']} seeds", f"{second}, {row['other_seeds']} seeds",
        millions(row["steps"]), _interval(row, "mean", "mean_low", "mean_high"), _number(row, row["other_mean"]),
        _interval(row, "difference", "low", "high"), *(number_text(row[p], ".2g", LEAST) for p in ("p", "p_holm")), settled,
    ]  # fmt: skip


def _short(name: str) -> str:
    """Return the name of a side with one word for the released script's options, and one for VaPRL's former defaults."""
    return name.replace(SCRIPT_OPTIONS, "released").replace(FORMER_VAPRL, "former")


def _cell_line(row: Row) -> list[str]:
    mean = interval_text(row["mean"], row["low"], row["high"])
    names = f"{row['env']} {row['algo']}, {row['seeds']} seeds", f"published, {millions(row['of'])} steps, 5 seeds"
    return [*names, millions(row["steps"]), mean, f"{row['other_mean']:.3f}", *"---", f"run; {verdict_text(row)}"]


def _number(row: Row, value: float) -> str:
    """Return a success with three decimals, a reward of a life with three digits, or a return with none."""
    is_return = row["metric"] == DEPLOYED and not make(row["env"]).sparse
    return number_text(value, ".3g" if row["metric"] == CONTINUING else ".0f" if is_return else ".3f")


def _interval(row: Row, *names: str) -> str:
    value, low, high = (_number(row, row[name]) for name in names)
    return f"{value} [{low}, {high}]"


def files() -> dict[Path, str]:
    """Return the tests as files."""
    rows, runs = comparisons(), read_runs()
    own_cells = cells(runs, paper_tests(runs))
    return {RUNS / "pairs.csv": csv_text(rows), RUNS / "pairs.md": f"{table(rows, own_cells)}\n\n{FAMILY}\n"}


def draw() -> None:
    """Draw the return of seeds 5 to 9 of difference 2, which trained longer than the first five, over their steps."""
    folders = [RUNS / names[1] for names in RELEASED_BOOTSTRAPPED + RELEASED_BIASED]
    names = [f"Reset every {horizon:,} steps{update}" for update in ("", ", biased update") for horizon in HORIZONS]
    plot_runs(folders, RUNS / CHEETAH / "curves.png", names, metric="deployed/return", smooth=5)


if __name__ == "__main__":
    write_files(files())
    draw()
