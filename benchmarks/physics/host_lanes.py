"""Time engine `c`'s control step of several lanes: on threads, in processes that know nothing of each other, and on workers.

    python -m benchmarks.physics.host_lanes --out benchmarks/results/physics/host_lanes_h200

Between two steps the caller is busy for `--pause-us`, as a GPU is. `threads`: one process with a thread for each lane, as the
engine has. `processes`: a process for each lane, each on its own; if they slow down as the threads do, then cores, caches or
memory are the limit. `workers`: a process for each lane that waits actively for the caller's rows in shared memory. They need a
core each, beside the caller's.
"""

import multiprocessing
import statistics
import time
from multiprocessing.shared_memory import SharedMemory
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
SPAWN = multiprocessing.get_context("spawn")


def prepared(name: str, lanes: int) -> tuple[c.Simulations, np.ndarray]:
    """Return simulations of `lanes` lanes on as many threads, and their input rows at a reset with the action 0."""
    jax.config.update("jax_platforms", "cpu")  # beside a GPU, the row of a started step is on its way to the host
    env: Any = make(name, engine="c")
    keys = jax.random.split(jax.random.key(0), lanes)
    data, command = jax.vmap(env.control)(jax.vmap(env.reset)(keys), jax.numpy.zeros((lanes, env.action_size)))
    rows = np.array(jax.vmap(lambda *of_lane: c.start_step(env.simulator, *of_lane).payload)(data, command), np.float32)
    host = c.host_of(env.simulator, env.reset(keys[0]).data.memory.size)
    return c.Simulations(host.simulator, host.model, host.memory, lanes, lanes), rows


def timed(step: Any, pause: float, steps: int) -> list[float]:
    """Return the seconds of `steps` calls of `step`, each after a pause."""
    seconds = []
    for _ in range(WARM + steps):
        paused = time.perf_counter() + pause
        while time.perf_counter() < paused:
            pass
        began = time.perf_counter()
        step()
        seconds.append(time.perf_counter() - began)
    return seconds[WARM:]


def alone(name: str, lanes: int, pause: float, steps: int, barrier: Any, results: Any) -> None:
    """Put the seconds of steps of `lanes` lanes in this process into `results`, from `barrier` on."""
    simulations, rows = prepared(name, lanes)
    barrier.wait()
    results.put(timed(lambda: simulations.advance(rows), pause, steps))


class Shared:
    """The shared memory of a caller and its workers: `rows [n, k]`, `answers [n, m]`, and the numbers of steps.

    `asked [1]` is the number of the last step that the caller wants, `done [n]` of the last one of each worker.
    """

    def __init__(self, lanes: int, width: int, out: int, name: str | None = None):
        sizes = np.cumsum([8, 8 * lanes, 4 * lanes * width, 4 * lanes * out])
        self.memory = SharedMemory(name, create=name is None, size=int(sizes[-1]))
        starts, kinds = [0, *map(int, sizes[:-1])], (np.int64, np.int64, np.float32, np.float32)
        shapes = (1,), (lanes,), (lanes, width), (lanes, out)
        self.asked, self.done, self.rows, self.answers = (
            np.ndarray(shape, kind, self.memory.buf, start)
            for shape, kind, start in zip(shapes, kinds, starts, strict=True)
        )

    def close(self) -> None:
        del self.asked, self.done, self.rows, self.answers
        self.memory.close()


def work(name: str, lane: int, sizes: tuple[int, int, int], memory: str, steps: int) -> None:
    """Answer `steps` steps of one lane."""
    (simulations, _), shared = prepared(name, 1), Shared(*sizes, name=memory)
    for number in range(1, steps + 1):
        while shared.asked[0] < number:
            pass
        shared.answers[lane] = simulations.advance(shared.rows[lane : lane + 1])[0]
        shared.done[lane] = number
    shared.close()


def with_workers(name: str, lanes: int, pause: float, steps: int) -> list[float]:
    """Return the seconds of steps that a worker for each lane computes; the first, which is not timed, waits for their start."""
    simulations, rows = prepared(name, lanes)
    expected = simulations.advance(rows)
    sizes = lanes, rows.shape[1], expected.shape[1]
    shared = Shared(*sizes)
    arguments = [(name, lane, sizes, shared.memory.name, WARM + steps) for lane in range(lanes)]
    workers = [SPAWN.Process(target=work, args=of_worker, daemon=True) for of_worker in arguments]
    for worker in workers:
        worker.start()

    def step() -> np.ndarray:
        shared.rows[:] = rows
        shared.asked[0] += 1
        while shared.done.min() < shared.asked[0]:
            pass
        return shared.answers.copy()

    seconds = timed(step, pause, steps)
    assert (shared.answers == expected).all()
    for worker in workers:
        worker.join()
    shared.memory.unlink()
    shared.close()
    return seconds


def on_their_own(name: str, lanes: int, processes: int, pause: float, steps: int) -> list[float]:
    """Return the seconds of steps in `processes` processes at once, with `lanes` lanes each."""
    barrier, results = SPAWN.Barrier(processes), SPAWN.Queue()
    workers = [
        SPAWN.Process(target=alone, args=(name, lanes, pause, steps, barrier, results)) for _ in range(processes)
    ]
    for worker in workers:
        worker.start()
    seconds = [second for _ in workers for second in results.get(timeout=120)]
    for worker in workers:
        worker.join()
    return seconds


def main(
    envs: tuple[str, ...] = ("franka_kitchen", "minitaur_pen"),
    lanes: tuple[int, ...] = (1, 2, 3, 5),
    pause_us: float = 150.0,
    steps: int = 2000,
    out: Path = RESULTS / "physics" / "host_lanes",
) -> None:
    """Time each number of `lanes` of each task in the three ways."""
    rows, pause = [], pause_us * 1e-6
    for name in envs:
        for count in lanes:
            for variant, seconds in {
                "threads": on_their_own(name, count, 1, pause, steps),
                "processes": on_their_own(name, 1, count, pause, steps),
                "workers": with_workers(name, count, pause, steps),
            }.items():
                mean, median, fastest = statistics.fmean(seconds), statistics.median(seconds), min(seconds)
                rows.append({
                    "env": name, "lanes": count, "variant": variant, "cores": len(own_cores()), "pause_us": pause_us,
                    "mean_ms": round(1e3 * mean, 4), "median_ms": round(1e3 * median, 4),
                    "fastest_ms": round(1e3 * fastest, 4),
                })  # fmt: skip
                print(rows[-1], flush=True)
    save_rows(out, rows)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
