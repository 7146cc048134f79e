"""The slots of this machine where programs run at the same time: a GPU, cores and a share of memory for each."""

import contextlib
import importlib.util
import itertools
import math
import os
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from earl_jax.options.environment import FRACTION, PER_DEVICE, own_cores
from earl_jax.options.values import counted
from earl_jax.sweeps.mps import MpsError, mps

PerDevice = int | Literal["auto"] | None
MOST = 48
"""The number of programs that MPS serves on a GPU."""
SHARED_FRACTION = 0.92
"""The part of a GPU's memory that several programs share; their CUDA contexts and MPS take some of the rest."""
NVIDIA_DRIVER = Path("/proc/driver/nvidia/gpus")
GAINS: dict[str, dict[tuple[int, int], float]] = {
    "tabletop_organization": {(2, 8): 1.302, (4, 4): 1.573},
    "sawyer_door": {(2, 8): 1.4, (4, 4): 1.71},
    "sawyer_peg": {(2, 8): 1.475, (4, 4): 1.717},
    "minitaur_pen": {(2, 8): 1.69, (4, 4): 2.485},
    "franka_kitchen": {(2, 8): 1.373, (4, 4): 2.072},
    "dhand_lightbulb": {(2, 8): 1.681, (4, 4): 2.523},
}
"""What `auto` decides by. By task and (programs on the GPU, cores of each): the time of equally many steps of each program
one after the other, over the time of all at once. The programs are different methods with 5 lanes in bf16 on one H200 with 16
cores, measured by `python -m benchmarks.speed.per_device`, which prints rows for this table."""


class Slot(NamedTuple):
    """What one worker may use: a `gpu` (None for jax's choice), `cores` (none for all), and 1 / `per_device` of the memory.

    `variables` are added to the environment: those of MPS.
    """

    gpu: str | None = None
    cores: tuple[int, ...] = ()
    per_device: int = 1
    variables: Mapping[str, str] = {}

    def environment(self, inherited: Mapping[str, str]) -> dict[str, str]:
        """Return the environment of a worker here, `inherited` with its GPU and its share of memory.

        With a GPU, JAX_PLATFORMS is `cuda,cpu` by default, so that a worker that cannot use its GPU ends with an error;
        it would be slow on the CPU.
        """
        variables = {**inherited, **self.variables, PER_DEVICE: str(self.per_device)}
        if self.gpu is None:
            return variables
        variables["CUDA_VISIBLE_DEVICES"] = self.gpu
        variables.setdefault("JAX_PLATFORMS", "cuda,cpu")
        if self.per_device > 1:
            variables[FRACTION] = f"{_memory_fraction(inherited) / self.per_device:.4f}"
        return variables


def _memory_fraction(environment: Mapping[str, str]) -> float:
    """Return the part of a GPU's memory that all programs on it may take: the user's, if it is smaller than ours."""
    try:
        return min(float(environment[FRACTION]), SHARED_FRACTION)
    except (KeyError, ValueError):
        return SHARED_FRACTION


def make_slots(
    per_device: int, gpus: Sequence[str], cores: Sequence[int], variables: Mapping[str, str] = {}
) -> list[Slot]:
    """Return `per_device` slots on each of `gpus`, or on a machine without one, in the order in which they are taken.

    Every GPU gets a program before one gets a second. The slots of a GPU have neighbouring cores, an even share each
    and at least one.
    """
    share = max(1, len(cores) // (per_device * max(len(gpus), 1)))
    result = []
    for position in range(per_device):
        for index, gpu in enumerate(gpus or [None]):
            first = (index * per_device + position) * share
            own = sorted(cores[(first + offset) % len(cores)] for offset in range(share))
            result.append(Slot(gpu, tuple(own), per_device, variables))
    return result


@contextlib.contextmanager
def open_slots(per_device: PerDevice, tasks: Sequence[str], emit: Callable[[str], None]) -> Iterator[list[Slot]]:
    """Yield the slots where programs of `tasks`, the name of each one's task, train at the same time.

    `emit` receives a line with the number of programs. MPS is on while several programs share a GPU; if it cannot be used,
    `emit` receives the cause and each GPU has one program.
    """
    if per_device is None or not tasks:
        yield [Slot()]  # a worker runs alone, as this process would
        return
    gpus, cores = visible_gpus(os.environ)[: len(tasks)], own_cores()
    if per_device == "auto":
        per_device = measured_programs(tasks, len(cores) / len(gpus)) if gpus else 1
    count = min(per_device, math.ceil(len(tasks) / max(len(gpus), 1)))
    with contextlib.ExitStack() as stack:
        variables, how = {}, ""
        if gpus and count > 1:
            try:
                variables = stack.enter_context(mps())
                how = " through the MPS daemon started for them" if variables else " through the running MPS daemon"
            except MpsError as error:
                count, how = 1, f"; MPS cannot be used: {error}"
        slots = make_slots(count, gpus, cores, variables)
        where = f" on each of {len(gpus)} GPUs" if len(gpus) > 1 else " on the GPU" if gpus else ""
        emit(f"{counted(count, 'program')} at a time{where}, {counted(len(slots[0].cores), 'core')} each{how}")
        yield slots


def measured_programs(tasks: Sequence[str], cores: float) -> int:
    """Return how many programs a GPU runs for the largest gain, for the one of `tasks` that allows the fewest.

    `cores` is the number of cores for each GPU. Several programs count only if each gets as many cores as in the
    measurement. A task that was not measured runs alone.
    """

    def best(task: str) -> int:
        gains = {1: 1.0} | {count: gain for (count, own), gain in GAINS.get(task, {}).items() if cores / count >= own}
        return max(gains, key=lambda count: (gains[count], -count))

    return min(map(best, tasks))


def cuda_plugin() -> Path | None:
    """Return the folder of jax's installed CUDA plugin, without importing jax; None if there is none."""
    spec = importlib.util.find_spec("jax_plugins")
    parents = spec.submodule_search_locations if spec is not None else None
    return next((folder for parent in parents or [] for folder in sorted(Path(parent).glob("xla_cuda*"))), None)


def visible_gpus(environment: Mapping[str, str]) -> list[str]:
    """Return the NVIDIA GPUs that jax can use here, as CUDA_VISIBLE_DEVICES names them, without importing jax."""
    platforms = {name.strip() for name in environment.get("JAX_PLATFORMS", "cuda").split(",")}
    if not platforms & {"cuda", "gpu", ""} or cuda_plugin() is None:
        return []
    count = _count_gpus()
    names = environment.get("CUDA_VISIBLE_DEVICES", ",".join(map(str, range(count)))).split(",")

    def exists(name: str) -> bool:
        return int(name) < count if name.isdecimal() else count > 0 and name.startswith(("GPU-", "MIG-"))

    # CUDA reads no further than the first that does not exist
    return list(itertools.takewhile(exists, map(str.strip, names)))


def _count_gpus() -> int:
    """Return the number of GPUs that nvidia-smi lists, or the driver where there is no nvidia-smi."""
    try:
        listing = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, timeout=30)
    except (OSError, subprocess.SubprocessError):
        return len(list(NVIDIA_DRIVER.iterdir())) if NVIDIA_DRIVER.is_dir() else 0
    return sum(line.startswith("GPU ") for line in listing.stdout.splitlines()) if listing.returncode == 0 else 0
