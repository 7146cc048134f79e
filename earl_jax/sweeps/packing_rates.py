"""The measured number of programs that `--per-device auto` runs on a GPU, by task and cores."""

from collections.abc import Iterable

RATES: dict[str, dict[tuple[int, int], float]] = {
    "tabletop_organization": {(1, 16): 6493.0, (2, 8): 4632.0, (4, 4): 2937.0},
    "sawyer_peg": {(1, 16): 2106.0, (2, 8): 914.0, (4, 4): 514.0},
}
"""Steps/s of each program by task and (programs on the GPU, cores of each): FBRL, 5 lanes, bf16, one H200.

From `python -m benchmarks.per_device`, which prints rows for this table. A task that is not in it runs alone. The rows of the
other tasks in benchmarks/results/per_device are older than a change of their programs and are left out.
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
