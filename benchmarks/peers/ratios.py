"""How many times faster earl_jax at 50 lanes is than each peer, and whether that meets the bar that was set before."""

from typing import Any, NamedTuple

from benchmarks.peers.common import DOOR, TABLETOP

LANES = 50
Row = dict[str, Any]


class Bar(NamedTuple):
    """What is compared: a peer with `lanes` a process, alone or side by side, and the `least` ratio, if one was set."""

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
    """Return one entry a bar: `ratio` of lane-steps a second over the peer's fastest such row, or None, and what it `says`."""
    return [entry(rows, bar) for bar in BARS]


def entry(rows: list[Row], bar: Bar) -> Row:
    mine = best(rows, "earl_jax", bar.task, LANES, False)
    theirs = best(rows, bar.peer, bar.task, bar.lanes, bar.side_by_side)
    what = f"earl_jax, {LANES} lanes of {bar.task}, over {bar.peer}"
    blank = {"over": bar.peer, "task": bar.task, "side_by_side": bar.side_by_side, "bar": bar.least}
    if mine is None or theirs is None:
        return {**blank, "ratio": None, "met": None, "says": f"{what}: no ratio, one of them was not measured"}
    ratio = mine["lane_steps_per_s"] / theirs["lane_steps_per_s"]
    met = None if bar.least is None else ratio >= bar.least
    verdict = "" if met is None else f", bar {bar.least:g}: {'met' if met else 'missed'}"
    size = f"{theirs['processes']} x {theirs['lanes']} lanes on {theirs['device']}"
    says = f"{what}: {ratio:.2f} times ({theirs['peer']}, {size}){verdict}"
    return {**blank, "ratio": round(ratio, 2), "met": met, "says": says}


def best(rows: list[Row], peer: str, task: str, lanes: int, side_by_side: bool) -> Row | None:
    """Return the fastest row of `peer`, or of its learners where it comes with several, or None where none ran."""
    found = [
        row
        for row in rows
        if row["peer"].removesuffix(", jax").removesuffix(", torch") == peer
        and (row["task"], row["lanes"], row["processes"] > 1) == (task, lanes, side_by_side)
        and row["lane_steps_per_s"]
    ]
    return max(found, key=lambda row: row["lane_steps_per_s"], default=None)
