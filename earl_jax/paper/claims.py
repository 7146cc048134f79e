"""Claims of the paper's text about tables 1 and 2, tested with its own seeds and with ours.

Source: Sharma et al. 2022, section 6.2.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from earl_jax import assets
from earl_jax.envs import PAPER_TASKS
from earl_jax.metrics.comparison import CANNOT_TELL, Sample
from earl_jax.paper.artefact import METHODS, Row, methods_on
from earl_jax.report.comparison import compared_texts, comparison_columns, untested, verdict_text, with_verdicts
from earl_jax.report.paper_rows import table_scores
from earl_jax.report.published import is_comparable, published_score, released_curves, training_steps
from earl_jax.report.runs import Curves, common_step
from earl_jax.report.scores import over_same_steps
from earl_jax.report.style import method_title, task_order, task_title
from earl_jax.report.tables import markdown_table, millions

Cell = tuple[str, str]
"""A task and a method."""
EPISODIC = "oracle"
"""The method that resets; it is not autonomous, and table 2 does not contain it."""


class Claim(NamedTuple):
    """A claim `text` about table `number`, by one comparison that it makes on a task.

    The method `first` scores above `second` or, if that is None, no higher at the end of its life than at the start.
    """

    number: int
    text: str
    env: str
    first: str
    second: str | None


AUTONOMOUS = tuple(algo for algo in METHODS if algo != EPISODIC)
STUCK = "sawyer_peg", "franka_kitchen"
NO_PROGRESS = "autonomous methods make no progress on the peg and in the kitchen"
BEST_WITH_DEMOS = "VaPRL is the best autonomous method where demonstrations are given"
CLAIMS = (
    Claim(1, "VaPRL outperforms the oracle on tabletop", "tabletop_organization", "vaprl", EPISODIC),
    *(Claim(1, NO_PROGRESS, env, algo, None) for env in STUCK for algo in methods_on(env, AUTONOMOUS)),
    *(
        Claim(1, BEST_WITH_DEMOS, env, "vaprl", algo)
        for env in PAPER_TASKS
        if "vaprl" in methods_on(env)
        for algo in AUTONOMOUS
        if algo != "vaprl"
    ),
    Claim(2, "VaPRL does better than naive RL on the door", "sawyer_door", "vaprl", "naive"),
    Claim(2, "R3L does better than naive RL with the Minitaur", "minitaur_pen", "r3l", "naive"),
)
"""The comparisons of the text, but for those of `counted` and one that contradicts table 1 (assets/published/faults.csv). The
text says of table 2 that VaPRL and R3L do better than naive RL; the tasks are ours, those where its means are so."""
HEADER = (
    "claim", "task", "comparison", "published", "adjusted p", "verdict", "ours", "steps", "adjusted p", "verdict",
)  # fmt: skip
NOT_RUN = "not run"
TOO_SHORT = "not tested: the beginning and end overlap"
WORDS = {"above": "as the text says", "below": "opposite to the text"}
PROGRESS = {"above": "progress", "below": "decline", CANNOT_TELL: "no progress found"}
CLAIM_RULE = (
    "Permutation tests of seeds over the same steps, the published ones of the released seeds at the published length (without "
    "any, Welch's of the printed numbers). p is adjusted by Holm over the comparisons of a claim on a task. Progress is the "
    "score at the end of a life minus that at its beginning, of as many evaluations, by the paired t test of seeds. The "
    "detectable difference is one that Welch's test, or the paired one, finds with a probability of 80 %."
)


def claims_text(number: int, runs: Sequence[Curves]) -> str:
    """Return a table of the tests of the claims about table `number`, and for table 2 what can be counted."""
    lines, last = [], ""
    for published, ours in zip(claim_rows(number), claim_rows(number, runs), strict=True):
        text = "the same" if published["text"] == last else published["text"]
        last = published["text"]
        methods = [method_title(algo) for algo in (published["first"], published["second"]) if algo]
        pair = " minus ".join(methods) if len(methods) > 1 else f"{methods[0]}, end minus beginning"
        (difference, _, p, _), (own_difference, _, own_p, _) = map(compared_texts, (published, ours))
        tests = [difference, p, word(published), own_difference, millions(ours["steps"]), own_p, word(ours)]
        lines.append([text, task_title(published["env"]), pair, *tests])
    table = f"Claims of the paper's text:\n\n{markdown_table(HEADER, lines)}\n\n{CLAIM_RULE}"
    return f"{table}\n\n{counted(runs)}" if number == 2 else table


def claim_rows(number: int, runs: Sequence[Curves] | None = None) -> list[Row]:
    """Return a row for each of `CLAIMS` about a table, tested with the `_comparable` ones of `runs`, or the published."""
    ours, rows = _comparable(runs or ()), []
    for claim in (claim for claim in CLAIMS if claim.number == number):
        names = [(claim.env, algo) for algo in (claim.first, claim.second) if algo]
        if runs is None:
            tested = _test(claim, [_released(*name) for name in names]) or _printed(claim)
        else:
            tested = _test(claim, [ours.get(name) for name in names])
        rows.append({**claim._asdict(), "steps": None, **untested(NOT_RUN), **tested})
    return with_verdicts(rows, family=("text", "env"))


def _released(env: str, algo: str) -> Curves | None:
    """Return the released runs of a cell up to the published length, which some exceed; None without any."""
    curves = released_curves(env, algo)
    return curves and curves.until(training_steps(env))


def _comparable(runs: Sequence[Curves]) -> dict[Cell, Curves]:
    """Return the run of each cell that can be compared with the paper's, of several the first, if possible with the defaults."""
    ordered = sorted(filter(is_comparable, runs), key=lambda curves: bool(curves.options))
    return {(curves.env, curves.algo): curves for curves in reversed(ordered)}


def _test(claim: Claim, curves: Sequence[Curves | None]) -> Row:
    """Return the columns of the test of a claim by the runs of its methods; {} without one of them."""
    first, second = curves[0], curves[-1]
    if first is None or second is None or not (step := common_step(first, second)):
        return {}
    first, second = over_same_steps((first, second), step)
    scores = table_scores(claim.number, first)
    if claim.second:
        return {"steps": step, **comparison_columns(scores, table_scores(claim.number, second))}
    count = first.window.count(first.steps)
    if len(first.steps) < 2 * count:
        return {"steps": step, "verdict": TOO_SHORT}
    beginning = first.metrics[first.deployed_metric][:, :count].mean(axis=1)
    none = Sample(0.0, 0.0, len(scores))
    return {"steps": step, **comparison_columns(Sample.of(scores - beginning), none)}


def _printed(claim: Claim) -> Row:
    """Return the columns of the test by the printed means and standard errors, which every claim without released runs has."""
    scores = [published_score(claim.number, claim.env, algo) for algo in (claim.first, claim.second) if algo]
    first, second = (sample for score in scores if score and (sample := score.sample))
    return comparison_columns(first, second)


def word(row: Row) -> str:
    """Return whether the test of a claim agrees with the text, or what is detectable."""
    return verdict_text(row, words=WORDS if row["second"] else PROGRESS)


def counted(runs: Sequence[Curves]) -> str:
    """Return the claims that count tasks of table 2, and whether they hold for the published scores and for our `runs`."""
    comparable = _comparable(runs).items()
    ours = {cell: [float(table_scores(number, curves).mean()) for number in (1, 2)] for cell, curves in comparable}
    return (
        f"Two more claims count tasks: naive RL is the best method on 2 tasks of table 2, and the ranks of the two "
        f"settings disagree. In the published tables {_counts(_published())}. In our runs {_counts(ours)}. "
        "The oracle is left out, and so is our lightbulb, which is another task. A task counts if at least two methods have both "
        "scores. These are counts of means, without a test."
    )


def _counts(scored: Mapping[Cell, Sequence[float]]) -> str:
    """Return what holds for the tasks of `scored`: J_D of the final policy and C(A) by task and method."""
    scores: dict[str, dict[str, Sequence[float]]] = {}
    for (env, algo), values in scored.items():
        if algo != EPISODIC:
            scores.setdefault(env, {})[algo] = values
    compared = {env: scores[env] for env in task_order(scores) if len(scores[env]) > 1}
    if not compared:
        return "no task has two methods to compare"
    naive = [env for env, methods in compared.items() if best(methods, 1) == {"naive"}]
    other_best = [env for env, methods in compared.items() if not best(methods, 0) & best(methods, 1)]
    swapped = [env for env, methods in compared.items() if changes_order(methods)]
    total = len(compared)
    names = f" ({', '.join(naive)})" if naive else ""
    return (
        f"naive RL is the best on {len(naive)} of {total}{names}, the best methods of tables 1 and 2 differ on "
        f"{len(other_best)} of {total}, and a pair of methods changes its order on {len(swapped)} of {total}"
    )


def best(methods: Mapping[str, Sequence[float]], score: int) -> set[str]:
    """Return the methods with the highest `score`: 0 for J_D, 1 for C(A)."""
    highest = max(values[score] for values in methods.values())
    return {name for name, values in methods.items() if values[score] == highest}


def changes_order(methods: Mapping[str, Sequence[float]]) -> bool:
    """Return whether one method is better than another by J_D and worse by C(A)."""
    pairs = itertools.combinations(methods.values(), 2)
    return any((first[0] - second[0]) * (first[1] - second[1]) < 0 for first, second in pairs)


def _published() -> dict[Cell, Sequence[float]]:
    cells = [(row["env"], row["algo"]) for row in assets.published("table2")]
    pairs = {cell: (published_score(1, *cell), published_score(2, *cell)) for cell in cells}
    return {cell: (first.value, second.value) for cell, (first, second) in pairs.items() if first and second}
