"""Pack the policies of finished runs into assets/pretrained: `python -m benchmarks.pretrained RUN...`.

A run's actors are rounded to float16 and evaluated. The best seeds ship, as many as fit into 300 kB, with the run's config
and their scores over episodes that did not choose them. A run ships if its best seed reaches LEAST of its goals. Rounding
must not cost success: a seed whose float16 actor is below the 95 % interval of its float32 actor does not ship.
"""

import functools
import io
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro
from flax.traverse_util import flatten_dict
from scipy.stats import binomtest
from tyro.conf import Positional

from earl_jax import assets
from earl_jax.envs import Env, chosen_engine, with_engine
from earl_jax.errors import InputError
from earl_jax.metrics.deployed import deployed
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.policies import policies_step
from earl_jax.training import Policy, load, load_policies
from earl_jax.training.policy import actor_of_arrays

PRETRAINED = assets.root() / "pretrained"
LEAST = 0.3
"""Smallest success of a run's best seed."""
MOST_SEEDS = 5
MOST_BYTES = 300_000
"""Size of the policies of one run."""
MOST_BYTES_IN_ALL = 10_000_000
EPISODES = 100
CHOOSE, MEASURE = 0, 1
"""Seeds of the episodes that choose the seeds to ship, and of those that are reported."""
METRICS = ("deployed/success", "deployed/return")


def lowest(share: float, episodes: int) -> float:
    """Return the low end of the 95 % interval of a `share` of `episodes`, by Wilson's score."""
    return binomtest(round(share * episodes), episodes).proportion_ci(method="wilson").low


def scores(env: Env, policies: Policy, seed: int, episodes: int) -> dict[str, np.ndarray]:
    """Return success and return [N] of N `policies` over `episodes` episodes each."""
    run = functools.partial(deployed, env, key=jax.random.key(seed), horizon=env.eval_horizon, episodes=episodes)
    results = jax.jit(jax.vmap(lambda policy: run(policy=policy)))(policies)
    return {name: np.asarray(values, float) for name, values in results.items()}


def chosen_lanes(original: dict[str, np.ndarray], rounded: dict[str, np.ndarray], episodes: int) -> list[int]:
    """Return the lanes that may ship, best first: by success, return and number, without those that rounding made worse."""
    success = rounded[METRICS[0]]
    lows = [lowest(share, episodes) for share in original[METRICS[0]]]
    kept = [lane for lane in range(len(success)) if success[lane] >= lows[lane]]
    return sorted(kept, key=lambda lane: (-success[lane], -rounded[METRICS[1]][lane], lane))


def arrays_of_actor(actor: Any) -> dict[str, np.ndarray]:
    """Return the float16 arrays, leaves [...], from which `actor_of_arrays` makes `actor`.

    Raises:
        ValueError: a weight is not finite in float16.
    """
    with np.errstate(over="ignore"):  # reported below
        leaves = flatten_dict(actor["params"], sep=".").items()
        arrays = {name: np.asarray(leaf, np.float16) for name, leaf in leaves}
    broken = [name for name, array in arrays.items() if not np.isfinite(array).all()]
    if broken:
        raise InputError(f"{broken[0]} has a weight that is not finite in float16")
    return arrays


def pack(folder: Path, out: Path, episodes: int = EPISODES, least: float = LEAST) -> dict[str, Any]:
    """Write the policies of the run at `folder` below `out`, and return their description.

    Raises:
        ValueError: `folder` has no policies, or they reach too few goals.
    """
    run = RunFolder.open(folder)
    env, policies = run.config.build_task(), load_policies(run)
    env = env if chosen_engine(env) == "kinematic" else with_engine(env, "c")
    arrays = arrays_of_actor(policies.actor)
    rounded = policies.replace(actor=actor_of_arrays(arrays))
    first = [scores(env, candidate, CHOOSE, episodes) for candidate in (policies, rounded)]
    lanes = chosen_lanes(*first, episodes)
    if not lanes or first[1][METRICS[0]][lanes[0]] < least:
        raise InputError(f"{folder}: no seed reaches {least} of its goals; {first[1][METRICS[0]].tolist()}")
    data, lanes = _packed(arrays, lanes)
    best = jax.tree.map(lambda leaf: leaf[np.array(lanes)], rounded)
    description = {
        "step": policies_step(run.policies),
        "seeds": [run.config.seeds[lane] for lane in lanes],
        "episodes": episodes,
        **{name: values.round(6).tolist() for name, values in scores(env, best, MEASURE, episodes).items()},
        "run": _training_scores(folder),
        "config": json.loads(run.config_file.read_text()),
    }
    _write(out / run.config.env / run.config.algo, data, description)
    return description


def _packed(arrays: dict[str, np.ndarray], lanes: list[int]) -> tuple[bytes, list[int]]:
    """Return an npz of as many of the `lanes` as fit, and those lanes."""
    for count in range(min(len(lanes), MOST_SEEDS), 0, -1):
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **{name: array[lanes[:count]] for name, array in arrays.items()})
        if buffer.tell() <= MOST_BYTES:
            break
    return buffer.getvalue(), lanes[:count]


def _training_scores(folder: Path) -> dict[str, Any]:
    """Return the score of every seed, which tells how typical the shipped seeds are."""
    score = load(folder).score()
    return {"evaluations": score.evaluations, score.metric: np.round(score.scores, 6).tolist()}


def _write(path: Path, data: bytes, description: dict[str, Any]) -> None:
    """Write `path`.npz and .json. Raises a ValueError if all files together would be too large."""
    others = [file for file in path.parents[1].glob("*/*") if file.with_suffix("") != path]
    total = len(data) + sum(file.stat().st_size for file in others)
    if total > MOST_BYTES_IN_ALL:
        raise InputError(f"{path}: all policies together would have {total} bytes, more than {MOST_BYTES_IN_ALL}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".npz").write_bytes(data)
    path.with_suffix(".json").write_text(json.dumps(description, indent=1) + "\n")


def main(
    runs: Positional[tuple[Path, ...]],
    out: Path = PRETRAINED,
    episodes: int = EPISODES,
    least: float = LEAST,
) -> None:
    """Pack the `runs`, and print a line for each."""
    for folder in runs:
        try:
            made = pack(folder, out, episodes, least)
            print(folder, "seeds", made["seeds"], "success", made[METRICS[0]], flush=True)
        except InputError as error:
            print(f"left out: {error}", flush=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
