"""The paper's three scores of a whole lifetime.

Source: Sharma et al. 2022, section 3.1: deployed and continuing policy evaluation.
"""

from typing import NamedTuple

import numpy as np


class Scores(NamedTuple):
    """Scores of N seeds.

    `final [N]`: J_D of the last policy. `deployed [N]`: the deployed curve averaged over the lifetime. `continuing
    [N]`: C(A), the task reward per step of the lifetime.
    """

    final: np.ndarray
    deployed: np.ndarray
    continuing: np.ndarray


def lifetime_scores(steps: np.ndarray, metrics: dict[str, np.ndarray], metric: str) -> Scores:
    """Return the scores of lanes evaluated at `steps [E]`, from `metrics` [N, E]; `metric` names the deployed one."""
    scores = metrics[metric]
    return Scores(scores[:, -1], deployed_area(steps, scores), metrics["continuing/reward"][:, -1])


def deployed_area(steps: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Return the area per step [...] under deployed curves `scores [..., E]`.

    Each evaluation is weighted by the steps since the previous one. The paper sums J_D(pi_t) over every t, which would
    need an evaluation at every step.
    """
    return (scores * np.diff(steps, prepend=0)).sum(axis=-1) / steps[-1]


def regret(steps: np.ndarray, scores: np.ndarray, best: float) -> np.ndarray:
    """Return the paper's D(A) [...]: the sum of J_D(pi*) - J_D(pi_t) over all steps; `best` is J_D(pi*)."""
    return (best - deployed_area(steps, scores)) * steps[-1]
