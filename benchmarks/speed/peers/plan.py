"""The rows of a suite, and the length of their measurements."""

import dataclasses

from benchmarks.speed.peers.common import DOOR, TABLETOP

LIMIT_S = {"quick": 290.0, "full": 470.0}
"""Seconds after which a suite starts no row."""
STEPS = {
    "cpu": {"earl_jax": {1: 300, 5: 80, 50: 10}, "rejax": {5: 40, 50: 4}, "sbx": 300, "brax": 300, "original": 300},
    "gpu": {"earl_jax": {1: 4000, 5: 4000, 50: 1500, 500: 200}, "rejax": {5: 400, 50: 100}, "sbx": 500, "brax": 3000,
            "original": 300},
}  # fmt: skip
"""Steps of each seed in one timed repeat (of three, after an untimed one), by lanes where the number of lanes matters."""
SHARED_GPU = 8
"""Processes of SBX that share one GPU."""
SMALL = 10_000
"""Replay rows of the row that shows the cost of rejax's sampling."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A row to measure: a script of this package, run in `processes` parallel processes on `device` (cpu or gpu)."""

    peer: str
    task: str
    module: str
    device: str
    steps: int
    lanes: int = 1
    processes: int = 1
    extra: tuple[str, ...] = ()
    limit_s: float = 100.0

    @property
    def ours(self) -> bool:
        """Whether this is a row of earl_jax, which runs in the interpreter of the suite."""
        return self.module == "ours"

    @property
    def arguments(self) -> tuple[str, ...]:
        """Arguments of the interpreter."""
        sizes = ("--lanes", str(self.lanes), "--steps", str(self.steps))
        return ("-m", f"benchmarks.speed.peers.{self.module}", *sizes, *self.extra)

    def barrier_arguments(self, number: int, folder: str) -> tuple[str, ...]:
        """Return more arguments of the `number`-th of parallel processes, which wait for each other in `folder`."""
        if self.processes == 1:
            return ()
        return ("--meet", folder, "--processes", str(self.processes), "--number", str(number))

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables that keep a row on its device."""
        return {"JAX_PLATFORMS": "cpu", "CUDA_VISIBLE_DEVICES": ""} if self.device == "cpu" else {}


def plan(suite: str, device: str, cores: int) -> list[Job]:
    """Return the rows of `suite` (quick or full) on `device` with `cores`; the rows that the ratios need come first."""
    jobs = [ours(TABLETOP, 50, device), sbx(device), rejax(50, device), ours(DOOR, 50, device)]
    jobs += [original("jax", device), original("torch", device), brax(device)]
    jobs += [ours(TABLETOP, lanes, device) for lanes in (5, 1)]
    jobs += [rejax(5, device), ours(DOOR, 5, device)]
    if suite == "quick":
        return jobs
    jobs += [sbx("cpu", cores)]
    if device != "cpu":
        jobs += [ours(TABLETOP, 500, device), sbx("cpu"), original("jax", "cpu"), sbx(device, SHARED_GPU)]
    return [*jobs, rejax(50, device, SMALL)]


def ours(task: str, lanes: int, device: str) -> Job:
    return Job("earl_jax", task, "ours", device, STEPS[device]["earl_jax"][lanes], lanes, extra=("--env", task))


def sbx(device: str, processes: int = 1) -> Job:
    return Job("sbx", TABLETOP, "sbx_sac", device, STEPS[device]["sbx"], processes=processes)


def rejax(lanes: int, device: str, capacity: int | None = None) -> Job:
    peer = "rejax" if capacity is None else f"rejax, {capacity:,} rows"
    extra = () if capacity is None else ("--capacity", str(capacity))
    return Job(peer, TABLETOP, "rejax_sac", device, STEPS[device]["rejax"][lanes], lanes, extra=extra)


def brax(device: str) -> Job:
    return Job("brax", TABLETOP, "brax_sac", device, STEPS[device]["brax"])


def original(learner: str, device: str) -> Job:
    extra = ("--learner", learner)
    return Job(f"original-style, {learner}", DOOR, "original", device, STEPS[device]["original"], extra=extra)
