"""The rows of a suite, the length of their measurements, and the ratios of earl_jax to each peer."""

import dataclasses
from typing import Any, NamedTuple

from benchmarks.speed.peers.common import DOOR, TABLETOP

LANES = 50
"""Lanes of earl_jax in the ratios."""
Row = dict[str, Any]
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


class Bar(NamedTuple):
    """A comparison: a peer with `lanes` per process, in one or in parallel processes, and the `least` ratio, if one was set."""

    peer: str
    task: str
    lanes: int
    side_by_side: bool
    least: float | None


BARS = (
    Bar("sbx", TABLETOP, 1, False, 10.0),
    Bar("rejax", TABLETOP, LANES, False, 2.0),
    Bar("brax", TABLETOP, 1, False, None),
    Bar("original-style", DOOR, 1, False, None),
    Bar("sbx", TABLETOP, 1, True, None),
)


def ratios(rows: list[Row]) -> list[Row]:
    """Return how earl_jax with `LANES` compares, one entry per bar.

    An entry has the `ratio` of lane-steps per second to the peer's fastest such row, or None, and a sentence.
    """
    return [entry(rows, bar) for bar in BARS]


def entry(rows: list[Row], bar: Bar) -> Row:
    own = best(rows, "earl_jax", bar.task, LANES, False)
    other = best(rows, bar.peer, bar.task, bar.lanes, bar.side_by_side)
    label = f"earl_jax, {LANES} lanes of {bar.task}, over {bar.peer}"
    blank = {"over": bar.peer, "task": bar.task, "side_by_side": bar.side_by_side, "bar": bar.least}
    if own is None or other is None:
        return {**blank, "ratio": None, "met": None, "says": f"{label}: no ratio, one of them was not measured"}
    ratio = own["lane_steps_per_s"] / other["lane_steps_per_s"]
    met = None if bar.least is None else ratio >= bar.least
    verdict = "" if met is None else f", bar {bar.least:g}: {'met' if met else 'missed'}"
    size = f"{other['processes']} x {other['lanes']} lanes on {other['device']}"
    sentence = f"{label}: {ratio:.2f} times ({other['peer']}, {size}){verdict}"
    return {**blank, "ratio": round(ratio, 2), "met": met, "says": sentence}


def best(rows: list[Row], peer: str, task: str, lanes: int, side_by_side: bool) -> Row | None:
    """Return the fastest row of `peer`, or of its learners if it has several; None if none ran."""
    candidates = [
        row
        for row in rows
        if row["peer"].removesuffix(", jax").removesuffix(", torch") == peer
        and (row["task"], row["lanes"], row["processes"] > 1) == (task, lanes, side_by_side)
        and row["lane_steps_per_s"]
    ]
    return max(candidates, key=lambda row: row["lane_steps_per_s"], default=None)
