"""Measure what a lifetime costs to compile: `python -m benchmarks.compile --envs minitaur_pen --before CHECKOUT --out FILE`.

A lifetime of two windows (one step in each explores or learns, and both evaluate) is traced, lowered and compiled for two
lanes in a process of its own, without a cache. The processes of this checkout and of `--before`, another one, alternate, and
their CPU time counts, which other work on the machine hardly changes. Writes FILE.json and FILE.csv.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.output import save
from earl_jax.envs import list_envs
from earl_jax.report.tables import write

ROOT = Path(__file__).parents[1]
COMPILE = """
import dataclasses, json, sys, time
import jax
import earl_jax
from earl_jax.physics.engines import mjx
from earl_jax.training.state import seed_keys

task, engine = sys.argv[1:]
steps_traced, step = [], mjx.step
mjx.step = lambda *arguments: steps_traced.append(0) or step(*arguments)
env = dataclasses.replace(earl_jax.make(task, engine=engine), eval_horizon=4)
protocol = earl_jax.Protocol(env.train_horizon, 4, eval_every=4, eval_episodes=2)
problem = earl_jax.Problem(env, protocol)
method = earl_jax.make_algo("naive", hidden_sizes=(16,), batch_size=16, random_steps=2)
keys = seed_keys(range(2))
jax.eval_shape(env.reset, keys[0])  # the model is loaded before the clock starts
if engine != "c":
    mjx._model(env.simulator)
times = [time.process_time()]
traced = jax.jit(lambda keys: earl_jax.lifetime(problem, method, keys, 8)).trace(keys)
times.append(time.process_time())
lowered = traced.lower()
times.append(time.process_time())
compiled = lowered.compile()
times.append(time.process_time())
parts = [after - before for before, after in zip(times, times[1:])]
print(json.dumps({
    "trace_s": parts[0], "lower_s": parts[1], "compile_s": parts[2], "all_s": sum(parts),
    "steps": len(steps_traced), "kernels": compiled.as_text().count(" fusion("),
}))
"""


def compile_once(checkout: Path, task: str, engine: str) -> dict[str, float]:
    """Return the CPU seconds of each part, the number of control steps in the program, and its kernels."""
    variables = {"PYTHONPATH": str(checkout), "JAX_PLATFORMS": "cpu", "JAX_ENABLE_COMPILATION_CACHE": "false"}
    command = [sys.executable, "-c", COMPILE, task, engine]
    result = subprocess.run(
        command, env={**os.environ, **variables}, cwd=checkout, capture_output=True, text=True, check=True
    )
    return json.loads(result.stdout.splitlines()[-1])


def rows_of(task: str, engine: str, checkouts: dict[str, Path], repeats: int) -> list[dict[str, Any]]:
    """Return a row with the medians of each checkout, and their ratio to the first one."""
    rounds = [{name: compile_once(path, task, engine) for name, path in checkouts.items()} for _ in range(repeats)]
    rows = []
    for name in checkouts:
        parts = {
            part: round(statistics.median(measured[name][part] for measured in rounds), 1) for part in rounds[0][name]
        }
        ratios = [measured[name]["all_s"] / measured[next(iter(checkouts))]["all_s"] for measured in rounds]
        rows.append(
            {"env": task, "engine": engine, "code": name, **parts, "ratio": round(statistics.median(ratios), 2)}
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--envs", nargs="+", default=["minitaur_pen"], choices=list_envs())
    parser.add_argument("--engines", nargs="+", default=["mjx"])
    parser.add_argument("--before", type=Path, help="a checkout of an earlier version")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/startup/compile"))
    arguments = parser.parse_args()
    checkouts = {"before": arguments.before.resolve()} if arguments.before else {}
    rows = []
    for task in arguments.envs:
        for engine in arguments.engines:
            rows += rows_of(task, engine, {**checkouts, "now": ROOT}, arguments.repeats)
            command = f"python -m benchmarks.compile --envs {' '.join(arguments.envs)} --engines {' '.join(arguments.engines)}"
            command += " --before CHECKOUT" * bool(arguments.before) + f" --repeats {arguments.repeats}"
            save(arguments.out.with_suffix(".json"), command, {"rows": rows})
            write(rows, arguments.out.with_suffix(".csv"))


if __name__ == "__main__":
    main()
