"""What a whole life was worth, in the paper's three numbers.

Source: Sharma et al. 2022, section 3.1: deployed and continuing policy evaluation.
"""

from typing import NamedTuple

import numpy as np


class Judgement(NamedTuple):
    """Scores of N seeds: `final [N]`, J_D of the last policy; `deployed [N]`, the mean height of the deployed curve over the
    lifetime; `continuing [N]`, C(A), task reward a step of the lifetime."""

    final: np.ndarray
    deployed: np.ndarray
    continuing: np.ndarray


def judged(steps: np.ndarray, metrics: dict[str, np.ndarray], metric: str) -> Judgement:
    """Return the judgement of lives evaluated at `steps [E]`, by `metrics` of arrays [N, E] and the deployed one, `metric`."""
    scores = metrics[metric]
    return Judgement(scores[:, -1], deployed_area(steps, scores), metrics["continuing/reward"][:, -1])


def deployed_area(steps: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Return the area per step [...] under deployed curves `scores [..., E]`: every evaluation stands for the steps since the
    one before, since J_D(pi_t) at every t, which the paper sums, would cost an evaluation a step."""
    return (scores * np.diff(steps, prepend=0)).sum(axis=-1) / steps[-1]


def regret(steps: np.ndarray, scores: np.ndarray, best: float) -> np.ndarray:
    """Return D(A) [...] as the paper sums it: J_D(pi*) - J_D(pi_t) over all steps, for an optimum J_D(pi*) = `best`."""
    return (best - deployed_area(steps, scores)) * steps[-1]
