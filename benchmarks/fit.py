"""Whether lanes of a whole published run fit on a device: `python -m benchmarks.fit --env dhand_lightbulb --lanes 100`.

Makes the whole replay, trains its first steps and its last ones (as if all between had been lived), and reports what the device
says it had to hold beside what was computed before. Writes FILE.json.
"""

import argparse
import os
from pathlib import Path

os.environ.setdefault("XLA_PYTHON_CLIENT_MEM_FRACTION", "0.95")

import jax
import jax.numpy as jnp

from benchmarks.output import tell
from earl_jax.algos import make_algo
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.training import memory
from earl_jax.training import runner as program
from earl_jax.training.state import Problem


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env", default="dhand_lightbulb")
    parser.add_argument("--algo", default="naive")
    parser.add_argument("--lanes", type=int, default=100)
    parser.add_argument("--steps", type=int, default=5_000_000)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/fit/run"))
    arguments = parser.parse_args()
    env, lanes, steps = make(arguments.env), arguments.lanes, arguments.steps
    problem = Problem(env, Protocol(env.train_horizon, env.eval_horizon))
    method = program.per_lane(make_algo(arguments.algo), lanes)
    needed = memory.need(problem, method, lanes, steps)
    memory.require(needed)
    lives = program._begin(problem, method, jax.vmap(jax.random.key)(jnp.arange(lanes)), steps, None)
    lives = program._advance(problem, method, lives, 100, True, None)
    lives = program._advance(problem, method, lives, 20, False, None)
    first = float(lives.lanes.counters.diagnostics["critic_loss"].mean())
    late = lives.replay.replace(row=jnp.asarray(steps - 20, jnp.int32))
    lives = program._advance(problem, method, lives.replace(replay=late), 20, False, None)
    stats = jax.devices()[0].memory_stats() or {}
    report = {
        "env": arguments.env, "lanes": lanes, "steps": steps, "computed_gb": needed.total / 1e9, "computed": str(needed),
        "peak_gb": stats.get("peak_bytes_in_use", 0) / 1e9, "limit_gb": stats.get("bytes_limit", 0) / 1e9,
        "first_loss": first, "last_loss": float(lives.lanes.counters.diagnostics["critic_loss"].mean()),
        "last_row_written": bool((lives.replay.action[-1] != 0).any()), "row": int(lives.replay.row),
    }  # fmt: skip
    command = f"python -m benchmarks.fit --env {arguments.env} --lanes {lanes} --steps {steps}"
    tell(report, arguments.out.with_suffix(".json"), command)


if __name__ == "__main__":
    main()
