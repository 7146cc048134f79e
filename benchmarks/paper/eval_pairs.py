"""The spread of deployed evaluations of a fixed policy in the kitchen: pairs drawn at random, and every pair equally often.

    python -m benchmarks.paper.eval_pairs [--evaluations-of-each N]

A pair is a start (two open appliances of four) with the goal. The policies do nothing, or are the one that ships. Writes
results/evaluation/pairs.csv: mean and standard deviation of N evaluations; and returns_by_pair.csv.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import earl_jax
from benchmarks.output import RESULTS, save_rows
from earl_jax.envs.kitchen.franka_kitchen import PAIRS, FrankaKitchen
from earl_jax.envs.starts import EVAL_PAIRS
from earl_jax.metrics.deployed import deployed, episode

FOLDER = RESULTS / "evaluation"
EPISODES = (10, 12)
"""Episodes of an evaluation: the paper's, and a multiple of the number of pairs."""
AT_ONCE = 20
"""Evaluations that run side by side."""


def nothing(obs: jax.Array) -> jax.Array:
    return jnp.zeros((*obs.shape[:-1], FrankaKitchen.action_size))


def returns_by_pair(env: FrankaKitchen, policy: Callable, episodes: int) -> np.ndarray:
    """Return the returns [pairs, episodes] of `policy` from every start."""

    numbered = env.starts.numbered
    assert numbered is not None

    def play(key: jax.Array, number: jax.Array) -> jax.Array:
        return episode(env, policy, numbered(key, number), env.eval_horizon)["return"]

    keys = jax.random.split(jax.random.key(1), (len(PAIRS), episodes))
    numbers = jnp.broadcast_to(jnp.arange(len(PAIRS))[:, None], keys.shape)
    return np.asarray(jax.jit(jax.vmap(jax.vmap(play)))(keys, numbers))


def evaluations(env: FrankaKitchen, policy: Callable, pairs: str, episodes: int, count: int) -> np.ndarray:
    """Return the returns [count] of `count` evaluations of `policy`, each of `episodes` episodes."""

    def evaluate(key: jax.Array) -> jax.Array:
        return deployed(env, policy, key, env.eval_horizon, episodes, pairs=pairs)["deployed/return"]

    keys = jax.random.split(jax.random.key(0), count)
    run = jax.jit(jax.vmap(evaluate))
    return np.concatenate([run(keys[first : first + AT_ONCE]) for first in range(0, count, AT_ONCE)])


def main(evaluations_of_each: int = 40, episodes_of_a_pair: int = 10) -> None:
    """Measure both policies and write the two tables."""
    env = FrankaKitchen(engine="c")
    policies = {"nothing": nothing, "shipped oracle": earl_jax.pretrained("franka_kitchen", "oracle")}
    rows: list[dict[str, Any]] = []
    of_pairs: list[dict[str, Any]] = []
    for name, policy in policies.items():
        by_pair = returns_by_pair(env, policy, episodes_of_a_pair)
        of_pairs += [
            {"policy": name, "open": " and ".join(pair), "mean": round(float(own.mean())), "sd": round(float(own.std(ddof=1)))}
            for pair, own in zip(PAIRS, by_pair, strict=True)
        ]  # fmt: skip
        of_pairs.append({"policy": name, "open": "all pairs", "mean": round(float(by_pair.mean()))})
        for pairs in EVAL_PAIRS:
            for episodes in EPISODES:
                values = evaluations(env, policy, pairs, episodes, evaluations_of_each)
                row = {"policy": name, "pairs": pairs, "episodes": episodes, "evaluations": len(values)}
                rows.append({**row, "mean": round(float(values.mean())), "sd": round(float(values.std(ddof=1)))})
                print(rows[-1], flush=True)
    save_rows(FOLDER / "pairs", rows)
    save_rows(FOLDER / "returns_by_pair", of_pairs, episodes_of_a_pair=episodes_of_a_pair)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
