"""Deployed evaluation of a finished or running run, from its folder."""

from pathlib import Path

import jax
import numpy as np

from earl_jax.envs import with_physics
from earl_jax.experiment import RunFolder
from earl_jax.metrics.deployed import deployed
from earl_jax.policy import Policy
from earl_jax.training import load_lanes

STARTS = ("initial", "uniform")


def evaluate(
    folder: str | Path, episodes: int = 100, seed: int = 0, physics: str | None = None, starts: str = "initial"
) -> dict[str, np.ndarray]:
    """Return `deployed/success` and `deployed/return` [N] of the newest policies in a run folder, over fresh episodes.

    Args:
        folder: a run folder with a checkpoint.
        episodes: greedy episodes of H_E steps for each seed's policy.
        seed: of starts and goals; the same for every policy, so that they are compared on the same episodes.
        physics: an engine other than the run's own.
        starts: `initial`, s0 ~ rho, or `uniform`, over the whole workspace (figure 5 of the paper), where the task has that.

    Raises:
        ValueError: not a run folder, or a missing or damaged checkpoint, or no such starts.
    """
    if starts not in STARTS:
        raise ValueError(f"unknown starts {starts!r}; choose from {', '.join(STARTS)}")
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, not {episodes}")
    env, method, lanes = load_lanes(RunFolder.open(Path(folder)))
    env = with_physics(env, physics)

    def one(m, lane):
        begin = env.scattered if starts == "uniform" else env.reset
        return deployed(env, Policy.of(env, m, lane), jax.random.key(seed), env.eval_horizon, episodes, begin)

    return {name: np.asarray(values) for name, values in jax.jit(jax.vmap(one))(method, lanes).items()}
