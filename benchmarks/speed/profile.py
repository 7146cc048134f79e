"""Profile a training step: `python -m benchmarks.speed.profile --envs sawyer_door --lanes 5 50 500 --out FILE`.

For every task and number of lanes it measures milliseconds of the whole step, of the step without learning (random actions,
physics, storing) and of the host's physics alone, on threads of this process, while beside a GPU other processes do it. A
profiler's trace of the whole step gives the milliseconds of the device's kernels by the named scopes of the loop, their
number, and the idle time of the device. Writes FILE.json and FILE.csv.
"""

import collections
import gzip
import itertools
import json
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from benchmarks.output import RESULTS, save_rows
from benchmarks.speed.peers.common import median_s
from benchmarks.speed.training import compile_steps, make_training
from earl_jax.cli.arguments import parse_options
from earl_jax.envs import MujocoEnv, chosen_engine
from earl_jax.physics import resolve_engine
from earl_jax.physics.engines import c
from earl_jax.training.state import Problem, TrainState

PARTS = ("update", "sample", "store", "act", "physics")
"""The named scopes of the loop."""
TRACED = 40


def milliseconds(call: Callable[[], Any], steps: int, repeats: int) -> float:
    """Return the median milliseconds of one of the `steps` of `call`, after one untimed call."""
    call()
    return 1e3 * median_s(call, repeats) / steps


def host_milliseconds(problem: Problem, state: TrainState, repeats: int = 50) -> float:
    """Return milliseconds of engine `c` for one control step of all lanes, without jax; 0 for other engines."""
    env, env_state = problem.env, state.lanes.env_state
    if not isinstance(env, MujocoEnv) or resolve_engine(env.engine) != "c":
        return 0.0
    simulator, data = env.simulator, env_state.data
    command = jax.vmap(lambda lane: env.control(lane, jnp.zeros(env.action_size))[1])(env_state)
    fields = [np.asarray(getattr(data, field)).reshape(len(command), -1) for field in c.CHANGED + c.CONSTANT]
    rows = np.concatenate([*fields, np.asarray(command)], axis=1)
    host = c.host_of(simulator, data.memory.shape[1])
    return milliseconds(lambda: [host(rows) for _ in range(repeats)], repeats, 3)


def scopes(text: str) -> dict[str, str]:
    """Return the scope of the loop that each named operation of a compiled program belongs to."""
    scope_of = {}
    for name, path in re.findall(r'%?([\w.\-]+) = [^\n]*metadata=\{[^}]*op_name="([^"]*)"', text):
        words = re.findall(r"\w+", path)
        scope_of[name] = next((word for word in words if word in PARTS), "")
    return scope_of


def trace(call: Callable[[], Any], steps: int, parts: dict[str, str]) -> dict[str, float]:
    """Return milliseconds by scope, kernels and idle milliseconds of a step on the device; an empty dict without one."""
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            call()
        files = list(Path(folder).rglob("*.trace.json.gz"))
        if not files:
            return {}
        events = json.loads(gzip.decompress(files[0].read_bytes()))["traceEvents"]
    devices = {
        event["pid"] for event in events if event.get("name") == "process_name" and "GPU" in event["args"]["name"]
    }
    streams = {
        (event["pid"], event["tid"]) for event in events
        if event.get("name") == "thread_name" and event["pid"] in devices and "Stream" in event["args"]["name"]
    }  # fmt: skip
    work = [event for event in events if event.get("ph") == "X" and (event["pid"], event["tid"]) in streams]
    return _summed(work, steps, parts) if work else {}


def _summed(work: list[dict[str, Any]], steps: int, parts: dict[str, str]) -> dict[str, float]:
    total: dict[str, float] = collections.defaultdict(float)
    for event in work:
        operation = event.get("args", {}).get("hlo_op") or event["name"]
        part = parts.get(operation) or parts.get(operation.replace("_", ".")) or _guess(event["name"])
        total[f"{part}_ms"] += event["dur"] / 1e3 / steps
    spans = sorted((event["ts"], event["ts"] + event["dur"]) for event in work)
    busy, end = 0.0, spans[0][0]
    for first, last in spans:
        busy, end = busy + max(0.0, last - max(first, end)), max(end, last)
    total["kernels"] = len(work) / steps
    total["idle_ms"] = (end - spans[0][0] - busy) / 1e3 / steps
    return {name: round(value, 4) for name, value in total.items()}


def _guess(kernel: str) -> str:
    products = ("gemm", "nvjet", "cutlass", "splitK", "cublas", "xmma", "mlp")
    if any(word.lower() in kernel.lower() for word in products):
        return "update"
    return "copy" if "memcpy" in kernel.lower() or "memset" in kernel.lower() else "other"


def measure(name: str, algo: str, lanes: int, steps: int, repeats: int, options: dict[str, Any]) -> dict[str, Any]:
    """Return the row of one task and number of lanes."""
    problem, method, start = make_training(name, algo, lanes, 2 * steps * (repeats + 4) + 4 * TRACED, **options)
    host_ms, state = host_milliseconds(problem, start), [start]
    warmup, *_ = compile_steps(problem, method, state, steps, warmup=True)
    without = milliseconds(warmup, steps, 2)
    whole, compiled, compile_s = compile_steps(problem, method, state, steps)
    step_ms = milliseconds(whole, steps, repeats)
    short, program, _ = compile_steps(problem, method, state, TRACED)
    short()
    row = {
        "env": name, "engine": resolve_engine(chosen_engine(problem.env)), "algo": algo, "lanes": lanes, **options,
        "step_ms": round(step_ms, 4), "steps_per_s": round(1e3 / step_ms, 1), "lane_steps_per_s": round(lanes * 1e3 / step_ms),
        "without_learning_ms": round(without, 4), "host_ms": round(host_ms, 4), "compile_s": round(compile_s, 1),
        "temporary_mb": round(compiled.memory_analysis().temp_size_in_bytes / 1e6, 1),
    }  # fmt: skip
    return {**row, **trace(short, TRACED, scopes(program.as_text()))}


def main(
    envs: tuple[str, ...] = ("tabletop_organization", "sawyer_door", "dhand_lightbulb"),
    algo: str = "naive",
    lanes: tuple[int, ...] = (5, 50, 500),
    steps: int = 300,
    repeats: int = 3,
    set: tuple[str, ...] = (),
    out: Path = RESULTS / "profile" / "run",
) -> None:
    """Profile each task with each number of lanes; `set` has name=value options of the method, such as precision=bf16."""
    rows = []
    for env, count in itertools.product(envs, lanes):
        rows.append(measure(env, algo, count, steps, repeats, parse_options(set)))
        print(rows[-1], flush=True)
        save_rows(out, rows)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
