"""The slots of a host where programs run at the same time: a GPU, cores and a share of memory for each. Imports no jax."""

import importlib.util
import math
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from earl_jax.machine import FRACTION, PER_DEVICE

SHARED_FRACTION = 0.92
"""The part of a GPU's memory that several programs share; their CUDA contexts and MPS take some of the rest."""
CUDA_PLUGIN = "xla_cuda*"
NVIDIA_DRIVER = Path("/proc/driver/nvidia/gpus")
SMI_SECONDS = 30


class Slot(NamedTuple):
    """What one of several workers may use: a `gpu` (None on a CPU), `cores`, and 1 / `per_device` of the memory."""

    gpu: str | None
    cores: tuple[int, ...]
    per_device: int

    def environment(self, inherited: Mapping[str, str]) -> dict[str, str]:
        """Return the environment of a worker here, `inherited` with its GPU and its share of memory.

        With a GPU, JAX_PLATFORMS is `cuda,cpu` by default, so that a worker that cannot use its GPU ends with an error;
        it would be slow on the CPU.
        """
        variables = {**inherited, PER_DEVICE: str(self.per_device)}
        if self.gpu is None:
            return variables
        variables["CUDA_VISIBLE_DEVICES"] = self.gpu
        variables.setdefault("JAX_PLATFORMS", "cuda,cpu")
        if self.per_device > 1:
            variables[FRACTION] = f"{memory_fraction(inherited) / self.per_device:.4f}"
        return variables

    def __str__(self) -> str:
        return f"GPU {self.gpu}" if self.gpu is not None else f"cores {','.join(map(str, self.cores))}"


def memory_fraction(environment: Mapping[str, str]) -> float:
    """Return the part of a GPU's memory that all programs on it may take: the user's, if it is smaller than ours."""
    try:
        return min(float(environment[FRACTION]), SHARED_FRACTION)
    except (KeyError, ValueError):
        return SHARED_FRACTION


def cuda_plugin() -> Path | None:
    """Return the folder of jax's installed CUDA plugin, without importing jax; None if there is none."""
    spec = importlib.util.find_spec("jax_plugins")
    parents = spec.submodule_search_locations if spec is not None else None
    return next((folder for parent in parents or [] for folder in sorted(Path(parent).glob(CUDA_PLUGIN))), None)


def visible_gpus(environment: Mapping[str, str]) -> list[str]:
    """Return the NVIDIA GPUs that jax can use here, as CUDA_VISIBLE_DEVICES names them, without importing jax."""
    platforms = environment.get("JAX_PLATFORMS", "")
    if platforms and not {"cuda", "gpu"} & {name.strip() for name in platforms.split(",")}:
        return []
    if cuda_plugin() is None:
        return []
    count = _count_gpus()
    chosen = environment.get("CUDA_VISIBLE_DEVICES")
    if chosen is None:
        return [str(number) for number in range(count)]
    return _usable_names(chosen, count)


def _usable_names(chosen: str, count: int) -> list[str]:
    """Return the names in CUDA_VISIBLE_DEVICES before the first that is invalid on a host of `count` GPUs, as CUDA does."""
    names: list[str] = []
    for name in (part.strip() for part in chosen.split(",")):
        valid = int(name) < count if name.isdigit() else count and name.startswith(("GPU-", "MIG-"))
        if not valid:
            break
        names.append(name)
    return names


def _count_gpus() -> int:
    """Return the number of GPUs that nvidia-smi lists, or the driver where there is no nvidia-smi."""
    try:
        listing = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, timeout=SMI_SECONDS)
    except (OSError, subprocess.SubprocessError):
        return len(list(NVIDIA_DRIVER.iterdir())) if NVIDIA_DRIVER.is_dir() else 0
    return sum(line.startswith("GPU ") for line in listing.stdout.splitlines()) if listing.returncode == 0 else 0


def needed(per_device: int, programs: int, gpus: int) -> int:
    """Return the number of programs on each GPU at a time: `per_device`, or fewer if there are not as many `programs`."""
    return max(1, min(per_device, math.ceil(programs / max(gpus, 1))))


def make_slots(per_device: int, gpus: Sequence[str], cores: Sequence[int]) -> list[Slot]:
    """Return `per_device` slots on each of `gpus`, or on a machine without one, in the order in which they are taken.

    Every GPU gets a program before one gets a second. The slots of a GPU have neighbouring cores, an even share each
    and at least one.
    """
    count = per_device * max(len(gpus), 1)
    share = max(1, len(cores) // count)
    result = []
    for position in range(per_device):
        for index, gpu in enumerate(gpus or [None]):
            first = (index * per_device + position) * share
            own = sorted(cores[(first + offset) % len(cores)] for offset in range(share))
            result.append(Slot(gpu, tuple(own), per_device))
    return result
