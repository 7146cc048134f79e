"""Time engine `c`'s control step of several lanes: a thread for each lane in one process, or a process for each lane.

    python -m benchmarks.physics.host_lanes --out benchmarks/results/physics/host_lanes_h200

Between two steps the caller is busy for `--pause-us`, as a GPU is. If the processes, which share no thread pool, slow down as
the threads do, then cores, caches or memory are the limit, and waking threads is not.
"""

import multiprocessing
import statistics
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from benchmarks.output import RESULTS, save_rows
from earl_jax.envs import make
from earl_jax.options.environment import own_cores
from earl_jax.physics.engines import c

WARM = 100
"""Steps before those that are timed."""


def times(name: str, lanes: int, pause: float, steps: int, barrier: Any, results: Any) -> None:
    """Put the seconds of `steps` control steps of `lanes` lanes on as many threads into `results`, from `barrier` on."""
    jax.config.update("jax_platforms", "cpu")  # beside a GPU, the row of a started step is on its way to the host
    env = make(name, engine="c")
    keys = jax.random.split(jax.random.key(0), lanes)
    data, command = jax.vmap(env.control)(jax.vmap(env.reset)(keys), jax.numpy.zeros((lanes, env.action_size)))
    rows = np.array(jax.vmap(lambda *of_lane: c.start_step(env.simulator, *of_lane).payload)(data, command), np.float32)
    host = c.host_of(env.simulator, env.reset(keys[0]).data.memory.size)
    simulations = c.Simulations(host.simulator, host.model, host.memory, lanes, lanes)
    seconds = []
    barrier.wait()
    for _ in range(WARM + steps):
        paused = time.perf_counter() + pause
        while time.perf_counter() < paused:
            pass
        began = time.perf_counter()
        simulations.advance(rows)
        seconds.append(time.perf_counter() - began)
    results.put(seconds[WARM:])


def step_row(name: str, lanes: int, processes: int, pause_us: float, steps: int) -> dict[str, Any]:
    """Return the mean, the median and the fastest time of a control step in `processes` processes at once."""
    spawn = multiprocessing.get_context("spawn")
    barrier, results = spawn.Barrier(processes), spawn.Queue()
    arguments = name, lanes, pause_us * 1e-6, steps, barrier, results
    workers = [spawn.Process(target=times, args=arguments) for _ in range(processes)]
    for worker in workers:
        worker.start()
    milliseconds = [1e3 * second for _ in workers for second in results.get(timeout=120)]
    for worker in workers:
        worker.join()
    return {
        "env": name, "processes": processes, "lanes each": lanes, "cores": len(own_cores()), "pause_us": pause_us,
        "mean_ms": round(statistics.fmean(milliseconds), 4), "median_ms": round(statistics.median(milliseconds), 4),
        "fastest_ms": round(min(milliseconds), 4),
    }  # fmt: skip


def main(
    envs: tuple[str, ...] = ("franka_kitchen", "minitaur_pen"),
    lanes: tuple[int, ...] = (1, 2, 3, 5),
    pause_us: float = 150.0,
    steps: int = 2000,
    out: Path = RESULTS / "physics" / "host_lanes",
) -> None:
    """Time each number of `lanes` of each task, first in one process and then in as many processes as lanes."""
    rows = []
    for name in envs:
        for count in lanes:
            for own, processes in {(count, 1), (1, count)}:
                rows.append(step_row(name, own, processes, pause_us, steps))
                print(rows[-1], flush=True)
    save_rows(out, rows)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
