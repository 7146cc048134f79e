"""The result of training, and one lane of it."""

import dataclasses
from typing import Any

import jax
import numpy as np

from earl_jax.algos import Method
from earl_jax.envs import Env
from earl_jax.errors import InputError
from earl_jax.metrics.scores import Scores, lifetime_scores
from earl_jax.runs.config import RunConfig, deployed_metric
from earl_jax.runs.hosts import gathered
from earl_jax.training.policy import Policy
from earl_jax.training.state import TrainState


@dataclasses.dataclass
class Result:
    """The result of training: `steps [E]`, `metrics` of arrays [N, E], and the final `train_state` of N `seeds`.

    `engine` names the physics engine that stepped the task, or is `kinematic`. After a time limit they end early
    (`finished` is False). Before the first evaluation, `metrics` is empty.
    """

    config: RunConfig
    env: Env
    method: Method
    seeds: tuple[int, ...]
    steps: np.ndarray
    metrics: dict[str, np.ndarray]
    train_state: TrainState
    engine: str

    @property
    def step(self) -> int:
        """The steps that each seed was trained."""
        return int(gathered(self.train_state.step))

    @property
    def finished(self) -> bool:
        """Whether training reached its last step, rather than a time limit."""
        return self.step >= self.config.steps

    @property
    def scores(self) -> Scores:
        """The paper's scores of the lifetimes: J_D, D(A), C(A).

        Raises:
            ValueError: training ended before the first evaluation.
        """
        if not len(self.steps):
            raise InputError(f"there is no evaluation yet: training ended at step {self.step}")
        return lifetime_scores(self.steps, self.metrics, deployed_metric(self.env))

    def policy(self, seed: int = 0) -> Policy:
        """Return the greedy task policy of the `seed`-th lane, callable on obs [..., o] of the task without help."""
        return Policy.of(self.env, select_seed(self.method, seed), select_seed(self.train_state, seed))


def select_seed(state: Any, i: int) -> Any:
    """Return lane `i` of `state`: a `LaneState` out of a `TrainState`, or any tree of arrays with a leading lane axis.

    Raises:
        IndexError: there is no such lane.
    """
    lanes = state.lanes if isinstance(state, TrainState) else state
    count = jax.tree.leaves(lanes)[0].shape[0]
    if not -count <= i < count:
        raise IndexError(f"no lane {i}: there are {count}")
    return _lane(lanes, i)


@jax.jit
def _lane(lanes: Any, i: jax.Array) -> Any:
    """Return lane `i`, by one program for all leaves."""
    return jax.tree.map(lambda leaf: leaf[i], lanes)
