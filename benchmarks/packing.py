"""What packing pays: methods in one program against one after the other, `python -m benchmarks.packing --lanes 5`.

A lane-step is one control step and one gradient step of one seed; compile time is apart, a round runs every program once.
"""

import argparse
import statistics
import time
from pathlib import Path

import jax
import jax.numpy as jnp

from benchmarks.output import tell
from earl_jax.algos import make_algo
from earl_jax.algos.mixed import mix_methods
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.training import init as birth
from earl_jax.training import loop as autonomy
from earl_jax.training.runner import per_lane
from earl_jax.training.state import Problem


def prepared(problem: Problem, algos: list[str], lanes: int, steps: int, options: dict) -> dict:
    """Return a compiled program of `lanes` lanes of each of `algos`, and the lives that it takes."""
    method = mix_methods([per_lane(make_algo(algo, **options), lanes) for algo in algos])
    keys = jax.vmap(jax.random.key)(jnp.tile(jnp.arange(lanes), len(algos)))
    capacity = birth.capacity_for(problem, method, 100_000)
    lives = jax.jit(lambda m, k: birth.begin(problem, m, k, capacity))(method, keys)
    advance = jax.jit(lambda m, state: autonomy.run(problem, m, state, steps), donate_argnums=1)
    began = time.perf_counter()
    program = advance.lower(method, lives).compile()
    return {"method": method, "lives": lives, "program": program, "compile_s": round(time.perf_counter() - began, 2)}


def measure(env: str, packs: list[list[str]], lanes: int, steps: int, rounds: int, options: dict) -> list[dict]:
    """Return the median seconds of `steps` of each pack; what fails says so and leaves the others alone."""
    task, ready, rows = make(env), {}, []
    problem = Problem(task, Protocol(task.train_horizon, task.eval_horizon))
    for algos in packs:
        name = "+".join(algos)
        try:
            ready[name] = prepared(problem, algos, lanes, steps, options)
            print(name, "compiled in", ready[name]["compile_s"], "s", flush=True)
        except Exception as error:
            print(name, "failed:", error, flush=True)
    times: dict[str, list[float]] = {name: [] for name in ready}
    for _ in range(rounds + 1):
        for name, one in ready.items():
            began = time.perf_counter()
            one["lives"] = one["program"](one["method"], one["lives"])
            jax.block_until_ready(one["lives"].step)
            times[name].append(time.perf_counter() - began)
    for name, seconds in times.items():
        middle, count = statistics.median(seconds[1:]), lanes * len(name.split("+"))
        rows.append({
            "program": name, "lanes": count, "seconds": round(middle, 4), "compile_s": ready[name]["compile_s"],
            "lane_steps_per_s": round(count * steps / middle, 1),
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
    asked = parser.parse_args()
    packs = [["naive"], ["oracle"], ["naive", "oracle"], ["naive", "naive"]]
    options = {"hidden_sizes": asked.hidden, "batch_size": asked.batch}
    rows = measure(asked.env, packs, asked.lanes, asked.steps, asked.rounds, options)
    took = {row["program"]: row["seconds"] for row in rows}
    gain = {}
    if {"naive", "oracle", "naive+oracle"} <= set(took):
        gain["packed_over_one_after_the_other"] = round((took["naive"] + took["oracle"]) / took["naive+oracle"], 3)
    hidden = " ".join(map(str, asked.hidden))
    command = (
        f"python -m benchmarks.packing --env {asked.env} --lanes {asked.lanes} --hidden {hidden} --batch {asked.batch}"
        f" --steps {asked.steps} --rounds {asked.rounds}"
    )
    tell({"rows": rows, **gain}, asked.out, command)


if __name__ == "__main__":
    main()
