"""Test how figure 5 depends on the width of "uniform": policies of the quickstart's size, evaluated from five kinds of starts.

python -m benchmarks.starts --out FILE.json [--steps 250000]
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.output import emit
from earl_jax.envs import Env, State, make
from earl_jax.envs.tabletop import FREE
from earl_jax.metrics.deployed import deployed
from earl_jax.physics import PhysicsState
from earl_jax.presets import PRESETS
from earl_jax.training import Policy, Result, train

TASK = "tabletop_organization"
EPISODES = 200


def within(env: Env, limit: float) -> Callable[[jax.Array], State]:
    """Return the starts of `env` with gripper and mug uniform in ±`limit`, and any task goal."""

    def start(key):
        position_key, goal_key = jax.random.split(key)
        qpos = jax.random.uniform(position_key, (4,), minval=-limit, maxval=limit)
        return env.with_goal(_at(env, key, qpos), env.sample_goal(goal_key))

    return start


def _at(env: Env, key: jax.Array, qpos: jax.Array) -> State:
    state = env.reset(key)
    obs = jnp.concatenate([qpos, FREE, state.info["goal"]])
    return state.replace(data=PhysicsState.at(qpos), obs=obs)


def starts(env: Env) -> dict[str, Callable[[jax.Array], State]]:
    """Return the kinds of starts by name: the task's own, the whole table, smaller squares, and the released wide ones."""
    wide = make(TASK, wide=True)
    return {
        "initial": env.reset,
        "uniform in 2.8": env.reset_uniform,
        "uniform in 2.5": within(env, 2.5),
        "uniform in 2.0": within(env, 2.0),
        "released wide": lambda key: _at(env, key, wide.reset(key).data.qpos),
    }


def evaluate(result: Result, start: Callable[[jax.Array], State]) -> list[float]:
    """Return the deployed success of each seed from the starts of `start`."""
    env = result.env

    def evaluate_lane(method, lane):
        policy = Policy.of(env, method, lane)
        return deployed(env, policy, jax.random.key(0), env.eval_horizon, EPISODES, start)["deployed/success"]

    success = jax.jit(jax.vmap(evaluate_lane))(result.method, result.train_state.lanes)
    return np.asarray(success).round(4).tolist()


def main() -> None:
    """Train and evaluate FBRL and the oracle."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=250_000)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    report = {}
    for algo in ("fbrl", "oracle"):
        result = train(
            TASK, algo, seeds=2, steps=arguments.steps, eval_every=50_000, progress=True, **PRESETS["quick"].options
        )
        report[algo] = {name: evaluate(result, start) for name, start in starts(result.env).items()}
    emit(
        {"steps": arguments.steps, "success": report},
        arguments.out,
        f"python -m benchmarks.starts --steps {arguments.steps}",
    )


if __name__ == "__main__":
    main()
