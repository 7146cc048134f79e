"""The speed of earl_jax with 50 lanes relative to each peer, and whether it meets a bar that was set before."""

from typing import Any, NamedTuple

from benchmarks.speed.peers.common import DOOR, TABLETOP

LANES = 50
Row = dict[str, Any]


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
    """Return one entry per bar: the `ratio` of lane-steps per second to the peer's fastest such row, or None, and a sentence."""
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
