"""Claims of the paper's text about tables 1 and 2, checked with its own numbers and with ours.

Source: Sharma et al. 2022, section 6.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence

from earl_jax import assets
from earl_jax.report.published import published_score
from earl_jax.report.runs import MethodRuns
from earl_jax.report.scores import seed_scores
from earl_jax.report.style import task_order

EPISODIC = "oracle"
"""The method that resets, which is no autonomous one and which table 2 lacks."""
NAIVE_BEST = 2
"""The number of tasks on which naive RL is the best method in table 2, in the paper's words."""


def table2_claims(groups: Sequence[MethodRuns]) -> str:
    """Return the claims about table 2, and whether they hold for the published scores and for the runs `groups`."""
    return (
        f"Claims of the paper's text: naive RL is the best method on {NAIVE_BEST} tasks of table 2, and the ranks of the two "
        f"settings disagree. In the published tables {_counts(_published())}. In our runs {_counts(_ours(groups))}. "
        "The oracle is left out; a task counts if at least two methods have both scores."
    )


def _counts(scored: Iterable[tuple[str, str, float, float]]) -> str:
    """Return what holds for the tasks of `scored`: task, method, J_D of the final policy and C(A), the first of each method."""
    scores: dict[str, dict[str, tuple[float, float]]] = {}
    for env, algo, deployed, continuing in scored:
        if algo != EPISODIC:
            scores.setdefault(env, {}).setdefault(algo, (deployed, continuing))
    compared = {env: scores[env] for env in task_order(scores) if len(scores[env]) > 1}
    if not compared:
        return "no task has two methods to compare"
    naive = [env for env, methods in compared.items() if "naive" in best(methods, 1)]
    other_best = [env for env, methods in compared.items() if not best(methods, 0) & best(methods, 1)]
    swapped = [env for env, methods in compared.items() if changes_order(methods)]
    total = len(compared)
    names = f" ({', '.join(naive)})" if naive else ""
    return (
        f"naive RL is the best on {len(naive)} of {total}{names}, the best methods of tables 1 and 2 differ on "
        f"{len(other_best)} of {total}, and a pair of methods changes its order on {len(swapped)} of {total}"
    )


def best(methods: Mapping[str, tuple[float, float]], score: int) -> set[str]:
    """Return the methods with the highest `score`: 0 for J_D, 1 for C(A)."""
    highest = max(values[score] for values in methods.values())
    return {name for name, values in methods.items() if values[score] == highest}


def changes_order(methods: Mapping[str, tuple[float, float]]) -> bool:
    """Return whether one method is better than another by J_D and worse by C(A)."""
    pairs = itertools.combinations(methods.values(), 2)
    return any((first[0] - second[0]) * (first[1] - second[1]) < 0 for first, second in pairs)


def _published() -> Iterable[tuple[str, str, float, float]]:
    for row in assets.published("table2"):
        scores = [published_score(table, row["env"], row["algo"]) for table in ("table1", "table2")]
        if scores[0] and scores[1]:
            yield row["env"], row["algo"], scores[0].value, scores[1].value


def _ours(groups: Sequence[MethodRuns]) -> Iterable[tuple[str, str, float, float]]:
    """Yield the mean scores of the runs that can be compared with the paper's."""
    for group in groups:
        curves = group.curves
        if curves.comparable:
            continuing = curves.metrics["continuing/reward"][:, -1]
            yield group.env, group.algo, float(seed_scores(curves).mean()), float(continuing.mean())
