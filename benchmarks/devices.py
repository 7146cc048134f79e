"""Measure how training scales over devices: `python -m benchmarks.devices --counts 1 2 --lanes 400 --out FILE`.

`--lanes` is the number on every device. Prints steps per second for each number of devices and its share of linear scaling,
and writes FILE.json and FILE.csv.
"""

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.output import save
from earl_jax.algos import make_algo
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.report.tables import write
from earl_jax.training import runner
from earl_jax.training.devices import lane_mesh, placed
from earl_jax.training.plan import per_lane
from earl_jax.training.state import Problem, seed_keys


def measure(
    name: str, algo: str, lanes: int, count: int, steps: int, repeats: int, options: dict[str, str]
) -> dict[str, Any]:
    """Return the rate of `lanes` lanes on each of `count` devices, the median of `repeats` calls."""
    total = lanes * count
    env, mesh = make(name).for_lanes(lanes), lane_mesh(count, total)
    problem = Problem(env, Protocol(env.train_horizon, env.eval_horizon))
    method = placed(per_lane(make_algo(algo, **options), total), mesh)
    rules = placed(jax.tree.map(lambda rule: jnp.full(total, rule), problem.protocol.rules), mesh)
    keys = placed(seed_keys(range(total)), mesh)
    state = runner._init(problem, method, keys, rules, steps * (repeats + 2) + 20_000, mesh)
    times = []
    for _ in range(repeats + 1):
        began = time.perf_counter()
        state = runner._advance(problem, method, state, steps, False, mesh)
        state.step.block_until_ready()
        times.append(time.perf_counter() - began)
    rate = steps / statistics.median(times[1:])
    return {
        "env": name, "algo": algo, **options, "devices": count, "lanes": total, "steps_per_s": round(rate, 2),
        "lane_steps_per_s": round(rate * total), "first_call_s": round(times[0], 1),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env", default="tabletop_organization")
    parser.add_argument("--algo", default="naive")
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--lanes", type=int, default=400)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--set", nargs="*", default=[], help="name=value options of the method, such as precision=bf16")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/devices/run"))
    arguments = parser.parse_args()
    options = dict(pair.split("=", 1) for pair in arguments.set)
    counts = " ".join(map(str, arguments.counts))
    command = f"python -m benchmarks.devices --env {arguments.env} --counts {counts} --lanes {arguments.lanes}"
    rows: list[dict[str, Any]] = []
    for count in arguments.counts:
        row = measure(
            arguments.env, arguments.algo, arguments.lanes, count, arguments.steps, arguments.repeats, options
        )
        base = rows[0]["lane_steps_per_s"] / rows[0]["devices"] if rows else row["lane_steps_per_s"] / count
        rows.append({**row, "of_linear": round(row["lane_steps_per_s"] / count / base, 3)})
        print(rows[-1], flush=True)
        save(arguments.out.with_suffix(".json"), command, {"rows": rows})
        write(rows, arguments.out.with_suffix(".csv"))


if __name__ == "__main__":
    main()
