"""Measure the scripted grasp of dhand_lightbulb and the return of no action: `python -m benchmarks.dhand --engine c`.

There are five documented starts (the bulb under the target and 4 cm to each side) and `--random` starts of the task's own, each
with an episode of no action, of random actions and of `env.expert`. A lift raises the bulb by 10 cm; a hold keeps it within
10 cm of the target for 5 s (50 consecutive control steps). Prints one JSON line and writes it to --out with its provenance.
"""

import argparse
import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.output import save
from earl_jax.envs import make
from earl_jax.envs.dhand.lightbulb import REST, TARGET

POLICIES = ("zero", "random", "scripted")
OFFSETS = np.array([[0.0, 0.0], [0.04, 0.0], [-0.04, 0.0], [0.0, 0.04], [0.0, -0.04]], np.float32)
HEIGHT = slice(25, 26)
LIFTED = 0.1
HOLD = 50


def start_states(env: Any, count: int, seed: int) -> Any:
    """Return the states of the documented starts, then `count` of the task's own, stacked."""
    named = jax.jit(jax.vmap(env.start_at))(jnp.asarray(TARGET[:2] + OFFSETS))
    own = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(seed), count))
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), named, own)


def run_episodes(env: Any, state: Any, steps: int, seed: int) -> dict[str, np.ndarray]:
    """Return reward, success, height of the bulb and fault [steps, policies, starts], all lanes of all policies at once."""
    count = len(state.reward)
    lanes = jax.tree.map(lambda leaf: jnp.concatenate([leaf] * len(POLICIES)), state)
    policy = jnp.repeat(jnp.arange(len(POLICIES)), count)[:, None]

    def step(state, key):
        noise = jax.random.uniform(key, (len(policy), env.action_size), minval=-1.0, maxval=1.0)
        scripted = jax.vmap(env.expert)(state.obs)
        action = jnp.where(policy == 0, 0.0, jnp.where(policy == 1, noise, scripted))
        state = jax.vmap(env.step)(state, action)
        return state, (
            state.reward,
            state.metrics["success"] > 0,
            state.obs[:, HEIGHT][:, 0],
            jax.vmap(env.fault)(state),
        )

    run = jax.jit(lambda lanes: jax.lax.scan(step, lanes, jax.random.split(jax.random.key(seed), steps))[1])
    curves = [np.asarray(leaf).reshape(steps, len(POLICIES), count) for leaf in run(lanes)]
    return dict(zip(("reward", "success", "height", "fault"), curves, strict=True))


def longest_run(success: np.ndarray) -> np.ndarray:
    """Return the largest number of consecutive successes [...] in `success [steps, ...]`."""
    best = run = np.zeros(success.shape[1:], int)
    for row in success:
        run = np.where(row, run + 1, 0)
        best = np.maximum(best, run)
    return best


def measure(engine: str, substeps: int, count: int, steps: int, seed: int) -> dict[str, Any]:
    """Return lifts, holds, heights and returns of every policy on `engine`."""
    env = dataclasses.replace(make("dhand_lightbulb", engine=engine, substeps=substeps), eval_horizon=steps)
    began = time.perf_counter()
    episodes = run_episodes(env, start_states(env, count, seed), steps, seed)
    lifted, held = episodes["height"].max(axis=0) > REST + LIFTED, longest_run(episodes["success"]) >= HOLD
    returns, named = episodes["reward"].sum(axis=0), len(OFFSETS)
    report: dict[str, Any] = {
        "env": env.name, "engine": env.resolved_engine, "substeps": substeps, "steps": steps, "seed": seed,
        "documented_starts": named, "random_starts": count,
        "lifts": int(lifted[2, :named].sum()), "holds": int(held[2, :named].sum()),
        "random_lifts": int(lifted[2, named:].sum()), "random_holds": int(held[2, named:].sum()),
        "steps_held": longest_run(episodes["success"])[2].tolist(),
        "highest_m": episodes["height"].max(axis=0)[2].astype(float).round(4).tolist(),
        "last_m": episodes["height"][-1, 2].astype(float).round(4).tolist(),
        "lowest_m": round(float(episodes["height"].min()), 4), "faults": int(episodes["fault"].sum()),
    }  # fmt: skip
    for index, policy in enumerate(POLICIES):
        own = returns[index, named:]
        report[f"return_{policy}"] = round(float(own.mean()), 1)
        report[f"return_{policy}_range"] = [round(float(own.min()), 1), round(float(own.max()), 1)]
    report["seconds"] = round(time.perf_counter() - began, 1)
    return report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engine", default="c", choices=("c", "mjx", "warp"))
    parser.add_argument("--substeps", type=int, default=10)
    parser.add_argument("--random", type=int, default=20)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None)
    chosen = parser.parse_args()
    report = measure(chosen.engine, chosen.substeps, chosen.random, chosen.steps, chosen.seed)
    print(json.dumps(report))
    out = chosen.out or Path(f"benchmarks/results/dhand/{chosen.engine}_{chosen.substeps}.json")
    options = f"--engine {chosen.engine} --substeps {chosen.substeps} --random {chosen.random}"
    command = f"python -m benchmarks.dhand {options} --steps {chosen.steps} --seed {chosen.seed}"
    save(out, command, report)


if __name__ == "__main__":
    main()
