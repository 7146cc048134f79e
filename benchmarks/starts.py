"""Whether figure 5 depends on how wide "uniform" is: policies of the quickstart's size, judged from starts of five kinds.

python -m benchmarks.starts --out FILE.json [--steps 250000]
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.output import tell
from earl_jax.cli.quickstart import PRESET
from earl_jax.envs import Env, State, make
from earl_jax.envs.tabletop import FREE
from earl_jax.metrics.deployed import deployed
from earl_jax.physics import PhysicsState
from earl_jax.training import Result, train
from earl_jax.training import Policy

TASK = "tabletop_organization"
EPISODES = 200


def _within(env: Env, limit: float) -> Callable[[jax.Array], State]:
    """Return starts with gripper and mug uniform in ±`limit`."""

    def begin(key):
        place_key, goal_key = jax.random.split(key)
        qpos = jax.random.uniform(place_key, (4,), minval=-limit, maxval=limit)
        return env.with_goal(_at(env, key, qpos), env.sample_goal(goal_key))

    return begin


def _at(env: Env, key: jax.Array, qpos: jax.Array) -> State:
    state = env.reset(key)
    obs = jnp.concatenate([qpos, FREE, state.info["goal"]])
    return state.replace(data=PhysicsState.at(qpos), obs=obs)


def starts(env: Env) -> dict[str, Callable[[jax.Array], State]]:
    """Return the kinds of starts by name: the task's, the whole table, smaller squares, and the released wide ones."""
    wide = make(TASK, wide=True)
    return {
        "initial": env.reset,
        "uniform in 2.8": env.reset_uniform,
        "uniform in 2.5": _within(env, 2.5),
        "uniform in 2.0": _within(env, 2.0),
        "released wide": lambda key: _at(env, key, wide.reset(key).data.qpos),
    }


def judged(result: Result, begin: Callable[[jax.Array], State]) -> list[float]:
    """Return the deployed success of each seed from the starts of `begin`."""
    env = result.env

    def one(method, lane):
        policy = Policy.of(env, method, lane)
        return deployed(env, policy, jax.random.key(0), env.eval_horizon, EPISODES, begin)["deployed/success"]

    found = jax.jit(jax.vmap(one))(result.method, result.lives.lanes)
    return np.asarray(found).round(4).tolist()


def main() -> None:
    """Train and judge FBRL and the oracle."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=250_000)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    report = {}
    for algo in ("fbrl", "oracle"):
        result = train(TASK, algo, seeds=2, steps=asked.steps, eval_every=50_000, progress=True, **PRESET)
        report[algo] = {name: judged(result, begin) for name, begin in starts(result.env).items()}
    tell({"steps": asked.steps, "success": report}, asked.out, f"python -m benchmarks.starts --steps {asked.steps}")


if __name__ == "__main__":
    main()
