"""The measured number of programs that `--per-device auto` runs on a GPU, by task and cores."""

from collections.abc import Iterable

RATES: dict[str, dict[tuple[int, int], float]] = {
    "sawyer_door": {(1, 16): 3003.0, (2, 8): 2500.0, (4, 4): 1850.0},
}
"""Steps/s of each program by task and (programs on the GPU, cores of each), 5 lanes, one H200.

From `python -m benchmarks.per_device`, which prints rows for this table. A task that is not in it runs alone.
"""


def measured_programs(tasks: Iterable[str], cores: float) -> int:
    """Return how many programs a GPU runs for the most steps in total, for the task of `tasks` that allows the fewest.

    `cores` is the number of cores for each GPU. Several programs count only if each gets as many cores as in the
    measurement.
    """
    return min((_best(RATES.get(task, {}), cores) for task in tasks), default=1)


def _best(rates: dict[tuple[int, int], float], cores: float) -> int:
    totals = {count: count * rate for (count, own), rate in rates.items() if count == 1 or cores / count >= own}
    return max(totals, key=lambda count: (totals[count], -count), default=1)
