"""Measure the start of a run without and with cached programs: `python -m benchmarks.startup --envs sawyer_door --out FILE`.

The training program of every task (5 lanes, the paper's networks) starts twice in a process of its own: with an empty cache,
and with the cache of the first start. Writes FILE.json and FILE.csv.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.output import save
from earl_jax.envs import list_envs
from earl_jax.report.tables import write

TRAIN = """
import json, sys
import jax
spent, events = {}, []
jax.monitoring.register_event_duration_secs_listener(lambda name, seconds, **_: spent.setdefault(name, []).append(seconds))
jax.monitoring.register_event_listener(lambda name, **_: events.append(name.rsplit("/", 1)[-1]))
import earl_jax
task, algo = sys.argv[1:]
earl_jax.train(task, algo, seeds=5, steps=1100, eval_every=1100, eval_episodes=1)
total = {name.rsplit("/", 1)[-1]: sum(seconds) for name, seconds in spent.items()}
print(json.dumps({
    "compile_s": total.get("backend_compile_duration", 0.0), "trace_s": total.get("jaxpr_trace_duration", 0.0),
    "lower_s": total.get("jaxpr_to_mlir_module_duration", 0.0), "kept": events.count("cache_hits"),
    "compiled": events.count("cache_misses"),
}))
"""


def start(task: str, algo: str, cache: str) -> dict[str, Any]:
    """Return the seconds of one process that trains 100 steps after the 1,000 random ones."""
    began = time.perf_counter()
    command = [sys.executable, "-c", TRAIN, task, algo]
    result = subprocess.run(
        command, env={**os.environ, "EARL_JAX_CACHE": cache}, capture_output=True, text=True, check=True
    )
    parts = {name: round(value, 2) for name, value in json.loads(result.stdout.splitlines()[-1]).items()}
    return {"process_s": round(time.perf_counter() - began, 2), **parts}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--envs", nargs="+", default=list_envs(), choices=list_envs())
    parser.add_argument("--algo", default="naive")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/startup/run"))
    arguments = parser.parse_args()
    command = f"python -m benchmarks.startup --envs {' '.join(arguments.envs)} --algo {arguments.algo}"
    rows = []
    for task in arguments.envs:
        with tempfile.TemporaryDirectory() as cache:
            for programs in ("empty", "kept"):
                rows.append(
                    {"env": task, "algo": arguments.algo, "cache": programs, **start(task, arguments.algo, cache)}
                )
                print(rows[-1], flush=True)
        save(arguments.out.with_suffix(".json"), command, {"rows": rows})
        write(rows, arguments.out.with_suffix(".csv"))


if __name__ == "__main__":
    main()
