"""The paper's three scores of a whole lifetime.

Source: Sharma et al. 2022, section 3.1: deployed and continuing policy evaluation.

Arguments are NumPy or JAX arrays, inside `jit` and `vmap` too, and results are of the same kind.
"""

from typing import Any, NamedTuple

from earl_jax.metrics.statistics import namespace_of


class Scores(NamedTuple):
    """Scores of lifetimes, such as [N] of N seeds.

    `final [...]`: J_D of the last policy. `deployed [...]`: the deployed curve averaged over the lifetime. `continuing
    [...]`: C(A), the task reward per step of the lifetime.
    """

    final: Any
    deployed: Any
    continuing: Any


def lifetime_scores(steps: Any, metrics: dict[str, Any], metric: str) -> Scores:
    """Return the scores of lives evaluated at `steps [E]`, from `metrics` [..., E]; `metric` names the deployed one."""
    scores = metrics[metric]
    return Scores(scores[..., -1], deployed_area(steps, scores), metrics["continuing/reward"][..., -1])


def deployed_area(steps: Any, scores: Any) -> Any:
    """Return the area per step [...] under deployed curves `scores [..., E]`.

    Each evaluation is weighted by the steps since the previous one. The paper sums J_D(pi_t) over every t, which would
    need an evaluation at every step.
    """
    return (scores * namespace_of(steps).diff(steps, prepend=0)).sum(axis=-1) / steps[-1]


def regret(steps: Any, scores: Any, best: float) -> Any:
    """Return the paper's D(A) [...]: the sum of J_D(pi*) - J_D(pi_t) over all steps; `best` is J_D(pi*)."""
    return (best - deployed_area(steps, scores)) * steps[-1]
