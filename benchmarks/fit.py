"""Test whether lanes of a whole published run fit on a device: `python -m benchmarks.fit --env dhand_lightbulb --lanes 100`.

Makes the whole replay, trains the first steps and the last ones (as if all steps between had been trained), and reports the
device's peak memory beside the computed one. Writes FILE.json.
"""

import argparse
import os
from pathlib import Path

os.environ.setdefault("XLA_PYTHON_CLIENT_MEM_FRACTION", "0.95")

import jax
import jax.numpy as jnp

from benchmarks.output import emit
from earl_jax.algos import make_algo
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.training import memory, runner
from earl_jax.training.demo_rows import replay_capacity
from earl_jax.training.plan import per_lane
from earl_jax.training.state import Problem, seed_keys


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
    method = per_lane(make_algo(arguments.algo), lanes)
    need = memory.need(problem, method, lanes, steps)
    memory.require(need)
    rules = jax.tree.map(lambda rule: jnp.full(lanes, rule), problem.protocol.rules)
    capacity = replay_capacity(problem, method, steps)
    state = runner._init(problem, method, seed_keys(range(lanes)), rules, capacity, None)
    state = runner._advance(problem, method, state, 100, True, None)
    state = runner._advance(problem, method, state, 20, False, None)
    first = float(state.lanes.counters.diagnostics["critic_loss"].mean())
    late = state.replay.replace(row=jnp.asarray(steps - 20, jnp.int32))
    state = runner._advance(problem, method, state.replace(replay=late), 20, False, None)
    stats = jax.devices()[0].memory_stats() or {}
    report = {
        "env": arguments.env, "lanes": lanes, "steps": steps, "computed_gb": need.total / 1e9, "computed": str(need),
        "peak_gb": stats.get("peak_bytes_in_use", 0) / 1e9, "limit_gb": stats.get("bytes_limit", 0) / 1e9,
        "first_loss": first, "last_loss": float(state.lanes.counters.diagnostics["critic_loss"].mean()),
        "last_row_written": bool((state.replay.action[-1] != 0).any()), "row": int(state.replay.row),
    }  # fmt: skip
    command = f"python -m benchmarks.fit --env {arguments.env} --lanes {lanes} --steps {steps}"
    emit(report, arguments.out.with_suffix(".json"), command)


if __name__ == "__main__":
    main()
