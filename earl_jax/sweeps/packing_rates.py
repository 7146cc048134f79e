"""The measured number of programs that `--per-device auto` runs on a GPU, by task and cores."""

from collections.abc import Iterable

GAINS: dict[str, dict[tuple[int, int], float]] = {
    "tabletop_organization": {(2, 8): 1.302, (4, 4): 1.573},
    "sawyer_door": {(2, 8): 1.4, (4, 4): 1.71},
    "sawyer_peg": {(2, 8): 1.475, (4, 4): 1.717},
    "minitaur_pen": {(2, 8): 1.69, (4, 4): 2.485},
    "franka_kitchen": {(2, 8): 1.373, (4, 4): 2.072},
    "dhand_lightbulb": {(2, 8): 1.681, (4, 4): 2.523},
}
"""By task and (programs on the GPU, cores of each): the time of equally many steps of each program one after the other, over
the time of all at once. The programs are different methods with 5 lanes in bf16 on one H200 with 16 cores.

From `python -m benchmarks.per_device`, which prints rows for this table. A task that is not in it runs alone.
"""


def measured_programs(tasks: Iterable[str], cores: float) -> int:
    """Return how many programs a GPU runs for the largest gain, for the task of `tasks` that allows the fewest.

    `cores` is the number of cores for each GPU. Several programs count only if each gets as many cores as in the
    measurement.
    """
    return min((_best(GAINS.get(task, {}), cores) for task in tasks), default=1)


def _best(gains: dict[tuple[int, int], float], cores: float) -> int:
    usable = {1: 1.0} | {count: gain for (count, own), gain in gains.items() if cores / count >= own}
    return max(usable, key=lambda count: (usable[count], -count))
