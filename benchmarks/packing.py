"""Compare methods in one program with one program after the other: `python -m benchmarks.packing --lanes 5`.

A lane-step is one control step and one gradient step of one seed. Compile time is separate. A round runs every program once.
"""

import argparse
import statistics
import time
from pathlib import Path

import jax

from benchmarks.output import emit
from earl_jax.algos import make_algo
from earl_jax.algos.mixed import mix_methods
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.training.demo_rows import replay_capacity
from earl_jax.training.init import init_train_state
from earl_jax.training.plan import per_lane
from earl_jax.training.scan import run_steps
from earl_jax.training.state import Problem, seed_keys


def compile_program(problem: Problem, algos: list[str], lanes: int, steps: int, options: dict) -> dict:
    """Return a compiled program of `lanes` lanes of each of `algos`, with its method and train state."""
    method = mix_methods([per_lane(make_algo(algo, **options), lanes) for algo in algos])
    keys = seed_keys([*range(lanes)] * len(algos))
    capacity = replay_capacity(problem, method, 100_000)
    state = jax.jit(lambda m, k: init_train_state(problem, m, k, capacity))(method, keys)
    advance = jax.jit(lambda m, state: run_steps(problem, m, state, steps), donate_argnums=1)
    began = time.perf_counter()
    program = advance.lower(method, state).compile()
    return {"method": method, "state": state, "program": program, "compile_s": round(time.perf_counter() - began, 2)}


def measure(env: str, groups: list[list[str]], lanes: int, steps: int, rounds: int, options: dict) -> list[dict]:
    """Return the median seconds of `steps` of each group of methods; a group that fails prints its error and is left out."""
    task, ready, rows = make(env), {}, []
    problem = Problem(task, Protocol(task.train_horizon, task.eval_horizon))
    for algos in groups:
        name = "+".join(algos)
        try:
            ready[name] = compile_program(problem, algos, lanes, steps, options)
            print(name, "compiled in", ready[name]["compile_s"], "s", flush=True)
        except Exception as error:
            print(name, "failed:", error, flush=True)
    times: dict[str, list[float]] = {name: [] for name in ready}
    for _ in range(rounds + 1):
        for name, ready_program in ready.items():
            began = time.perf_counter()
            state = ready_program["program"](ready_program["method"], ready_program["state"])
            ready_program["state"] = state
            jax.block_until_ready(state.step)
            times[name].append(time.perf_counter() - began)
    for name, seconds in times.items():
        median, count = statistics.median(seconds[1:]), lanes * len(name.split("+"))
        rows.append({
            "program": name, "lanes": count, "seconds": round(median, 4), "compile_s": ready[name]["compile_s"],
            "lane_steps_per_s": round(count * steps / median, 1),
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env", default="tabletop_organization")
    parser.add_argument("--lanes", type=int, default=5, help="of each method")
    parser.add_argument("--hidden", type=int, nargs="+", default=[256, 256])
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    groups = [["naive"], ["oracle"], ["naive", "oracle"], ["naive", "naive"]]
    options = {"hidden_sizes": arguments.hidden, "batch_size": arguments.batch}
    rows = measure(arguments.env, groups, arguments.lanes, arguments.steps, arguments.rounds, options)
    seconds = {row["program"]: row["seconds"] for row in rows}
    gain = {}
    if {"naive", "oracle", "naive+oracle"} <= set(seconds):
        gain["packed_over_one_after_the_other"] = round(
            (seconds["naive"] + seconds["oracle"]) / seconds["naive+oracle"], 3
        )
    hidden = " ".join(map(str, arguments.hidden))
    command = (
        f"python -m benchmarks.packing --env {arguments.env} --lanes {arguments.lanes} --hidden {hidden}"
        f" --batch {arguments.batch} --steps {arguments.steps} --rounds {arguments.rounds}"
    )
    emit({"rows": rows, **gain}, arguments.out, command)


if __name__ == "__main__":
    main()
