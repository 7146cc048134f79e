"""Time engine `c`'s control step of a few lanes: as it is, and with threads or cores that do not fall asleep.

    python -m benchmarks.physics.host_threads --lanes 5 --out benchmarks/results/physics/host_threads_h200

Between two steps the caller is busy for `--pause-us`, as a GPU is. The variants take turns. `pinned`: each of MuJoCo's threads
has every second core, so that two do not share a physical one. `awake`: the caller gives the threads an empty task before they
fall asleep, which they do 50 us after a step. `busy`: a process of the lowest priority (SCHED_IDLE) runs on every core, so that
none halts; a virtual machine takes long to wake a halted core. Results are equal bit for bit.
"""

import contextlib
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from benchmarks.output import RESULTS, save_rows
from earl_jax.envs import make
from earl_jax.options.environment import own_cores
from earl_jax.physics.engines import c

AWAKE_US = 30
"""Time after which an awake variant gives its threads the next empty task."""
NO_STAGE = 0
"""MuJoCo's mjSTAGE_NONE: a forward pass up to it computes nothing."""
SPIN = "import os; os.sched_setaffinity(0, {%d}); os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\nwhile True: pass"
VARIANTS = {
    "as is": (), "pinned": ("pinned",), "awake": ("awake",), "busy": ("busy",), "pinned and busy": ("pinned", "busy"),
}  # fmt: skip


def threads_of_process() -> set[int]:
    return set(map(int, os.listdir("/proc/self/task")))


def first_rows(env: Any, lanes: int) -> np.ndarray:
    """Return input rows of engine `c` for `lanes` lanes with random actions."""
    keys = jax.random.split(jax.random.key(0), lanes)
    actions = jax.random.uniform(jax.random.key(1), (lanes, env.action_size), minval=-1.0, maxval=1.0)
    data, command = jax.vmap(env.control)(jax.vmap(env.reset)(keys), actions)
    started = jax.vmap(lambda *of_lane: c.start_step(env.simulator, *of_lane))(data, command)
    return np.asarray(started.payload, np.float32)


@contextlib.contextmanager
def spinning_processes() -> Iterator[list[subprocess.Popen]]:
    """Yield a stopped process for each core, which spins on it at the lowest priority once it is continued."""
    processes = [subprocess.Popen([sys.executable, "-c", SPIN % core]) for core in sorted(own_cores())]
    time.sleep(1)
    try:
        signal_all(processes, signal.SIGSTOP)
        yield processes
    finally:
        signal_all(processes, signal.SIGKILL)


def signal_all(processes: list[subprocess.Popen], number: signal.Signals) -> None:
    for process in processes:
        process.send_signal(number)


class Variant:
    """The simulations of one variant and their rows; `step` times a control step after a pause."""

    def __init__(self, env: Any, rows: np.ndarray, threads: int, how: tuple[str, ...]):
        before, host = threads_of_process(), c.host_of(env.simulator, env.reset(jax.random.key(0)).data.memory.size)
        self.simulations = c.Simulations(host.simulator, host.model, host.memory, len(rows), threads)
        self.rows, self.how, self.seconds = rows.copy(), how, []
        if "pinned" in how:
            cores = sorted(own_cores())[2::2] or sorted(own_cores())
            for number, thread in enumerate(sorted(threads_of_process() - before)):
                os.sched_setaffinity(thread, {cores[number % len(cores)]})

    def step(self, pause: float) -> None:
        began = last = time.perf_counter()
        while (now := time.perf_counter()) < began + pause:
            if "awake" in self.how and now > last + AWAKE_US * 1e-6:
                self.simulations.batch.forward(stage=NO_STAGE)
                last = time.perf_counter()
        began = time.perf_counter()
        after = self.simulations.advance(self.rows)
        self.seconds.append(time.perf_counter() - began)
        changed = after.shape[1] - self.simulations.sensors.shape[1]
        self.rows[:, :changed] = after[:, :changed]


def measure(name: str, lanes: int, threads: int, pause_us: float, steps: int, rounds: int) -> list[dict[str, Any]]:
    """Return the mean, the median and the ratio to the first of each variant of a task's control step."""
    env = make(name, engine="c")
    rows = first_rows(env, lanes)
    variants = {variant: Variant(env, rows, threads, how) for variant, how in VARIANTS.items()}
    with spinning_processes() as processes:
        for number in range(rounds + 1):
            for variant in variants.values():
                busy = processes if "busy" in variant.how else []
                signal_all(busy, signal.SIGCONT)
                for _ in range(steps if number else 10):
                    variant.step(pause_us * 1e-6)
                signal_all(busy, signal.SIGSTOP)
                variant.seconds = variant.seconds if number else []
    results = []
    for variant, own in variants.items():
        mean = statistics.fmean(own.seconds)
        results.append({
            "env": name, "lanes": lanes, "threads": threads, "cores": len(own_cores()), "pause_us": pause_us,
            "variant": variant, "mean_ms": round(1e3 * mean, 4), "median_ms": round(1e3 * statistics.median(own.seconds), 4),
            "ratio": round(mean / statistics.fmean(variants["as is"].seconds), 3),
            "equal": bool((own.rows == variants["as is"].rows).all()),
        })  # fmt: skip
        print(results[-1], flush=True)
    return results


def main(
    envs: tuple[str, ...] = ("franka_kitchen", "dhand_lightbulb", "minitaur_pen", "sawyer_door"),
    lanes: int = 5,
    threads: int | None = None,
    pause_us: tuple[float, ...] = (100.0, 200.0),
    steps: int = 500,
    rounds: int = 4,
    out: Path = RESULTS / "physics" / "host_threads",
) -> None:
    """Measure each task after each pause, in `rounds` rounds of `steps` steps; `threads` are one a lane, on half the cores."""
    jax.config.update("jax_platforms", "cpu")  # beside a GPU, the row of a started step is on its way to the host
    threads = threads or min(lanes, max(1, len(own_cores()) // 2))
    rows = [row for name in envs for pause in pause_us for row in measure(name, lanes, threads, pause, steps, rounds)]
    save_rows(out, rows)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
