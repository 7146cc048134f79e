"""The rows of the suite, the length of their measurements, and the ratios of earl_jax to each peer."""

import dataclasses
from typing import Any

from benchmarks.speed.peers.common import DOOR, TABLETOP

LANES = 50
"""Lanes of earl_jax in the ratios."""
Row = dict[str, Any]
STEPS = {
    "cpu": {"earl_jax": {1: 300, 5: 80, 50: 10}, "rejax": {5: 40, 50: 4}, "sbx": 300, "brax": 300, "original": 300},
    "gpu": {"earl_jax": {1: 4000, 5: 4000, 50: 1500}, "rejax": {5: 400, 50: 100}, "sbx": 500, "brax": 3000, "original": 300},
}  # fmt: skip
"""Steps of each seed in one timed repeat (of three, after an untimed one), by lanes where the number of lanes matters."""
RATIOS = {"sbx": (TABLETOP, 1), "rejax": (TABLETOP, LANES), "brax": (TABLETOP, 1), "original-style": (DOOR, 1)}
"""The peers that earl_jax is compared with: the task, and the lanes of a process of theirs."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A row to measure: a script of this package, in a process of its own."""

    peer: str
    task: str
    module: str
    steps: int
    lanes: int = 1
    extra: tuple[str, ...] = ()

    @property
    def ours(self) -> bool:
        """Whether this is a row of earl_jax, which runs in the interpreter of the suite."""
        return self.module == "ours"

    @property
    def arguments(self) -> tuple[str, ...]:
        """Arguments of the interpreter."""
        sizes = ("--lanes", str(self.lanes), "--steps", str(self.steps))
        return ("-m", f"benchmarks.speed.peers.{self.module}", *sizes, *self.extra)


def plan(device: str) -> list[Job]:
    """Return the rows of the suite on `device` (cpu or gpu); those that the ratios need come first."""
    steps: Any = STEPS[device]

    def ours(task: str, lanes: int) -> Job:
        return Job("earl_jax", task, "ours", steps["earl_jax"][lanes], lanes, ("--env", task))

    def rejax(lanes: int) -> Job:
        return Job("rejax", TABLETOP, "rejax_sac", steps["rejax"][lanes], lanes)

    def original(learner: str) -> Job:
        return Job(f"original-style, {learner}", DOOR, "original", steps["original"], extra=("--learner", learner))

    sbx, brax = (Job(peer, TABLETOP, f"{peer}_sac", steps[peer]) for peer in ("sbx", "brax"))
    first = [ours(TABLETOP, LANES), sbx, rejax(LANES), ours(DOOR, LANES), original("jax"), original("torch"), brax]
    return [*first, ours(TABLETOP, 5), ours(TABLETOP, 1), rejax(5), ours(DOOR, 5)]


def ratios(rows: list[Row]) -> list[Row]:
    """Return how earl_jax with `LANES` compares with each peer.

    An entry has the `ratio` of lane-steps per second to the peer's fastest such row, or None, and a sentence.
    """
    return [_ratio(rows, peer, *sizes) for peer, sizes in RATIOS.items()]


def _ratio(rows: list[Row], peer: str, task: str, lanes: int) -> Row:
    own, other = _best(rows, "earl_jax", task, LANES), _best(rows, peer, task, lanes)
    label, entry = f"earl_jax, {LANES} lanes of {task}, over {peer}", {"over": peer, "task": task, "ratio": None}
    if own is None or other is None:
        return {**entry, "says": f"{label}: no ratio, one of them was not measured"}
    ratio = own["lane_steps_per_s"] / other["lane_steps_per_s"]
    sentence = f"{label}: {ratio:.2f} times ({other['peer']}, {other['lanes']} lanes on {other['device']})"
    return {**entry, "ratio": round(ratio, 2), "says": sentence}


def _best(rows: list[Row], peer: str, task: str, lanes: int) -> Row | None:
    """Return the fastest row of `peer`, or of its learners if it has several; None if none ran."""
    candidates = [
        row
        for row in rows
        if row["peer"].partition(",")[0] == peer
        and (row["task"], row["lanes"]) == (task, lanes)
        and row["lane_steps_per_s"]
    ]
    return max(candidates, key=lambda row: row["lane_steps_per_s"], default=None)
