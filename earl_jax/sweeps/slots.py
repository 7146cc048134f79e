"""The slots of this machine where programs run at the same time: a GPU, cores and a share of memory for each. Imports no jax."""

import contextlib
import importlib.util
import math
import os
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from earl_jax.errors import InputError
from earl_jax.machine import FRACTION, PER_DEVICE, own_cores
from earl_jax.sweeps.mps import MpsError, mps
from earl_jax.sweeps.packing_rates import measured_programs

PerDevice = int | Literal["auto"] | None
MOST = 48
"""The number of programs that MPS serves on a GPU."""
SHARED_FRACTION = 0.92
"""The part of a GPU's memory that several programs share; their CUDA contexts and MPS take some of the rest."""
CUDA_PLUGIN = "xla_cuda*"
NVIDIA_DRIVER = Path("/proc/driver/nvidia/gpus")
SMI_SECONDS = 30


class Slot(NamedTuple):
    """What one of several workers may use: a `gpu` (None on a CPU), `cores`, and 1 / `per_device` of the memory.

    `variables` are those of MPS.
    """

    gpu: str | None
    cores: tuple[int, ...]
    per_device: int
    variables: Mapping[str, str] = {}

    @property
    def arguments(self) -> list[str]:
        """The options of the worker's command."""
        return ["--cores", *map(str, self.cores)]

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

    def __str__(self) -> str:
        return f"GPU {self.gpu}" if self.gpu is not None else f"cores {','.join(map(str, self.cores))}"


def _memory_fraction(environment: Mapping[str, str]) -> float:
    """Return the part of a GPU's memory that all programs on it may take: the user's, if it is smaller than ours."""
    try:
        return min(float(environment[FRACTION]), SHARED_FRACTION)
    except (KeyError, ValueError):
        return SHARED_FRACTION


def make_slots(
    per_device: int, gpus: Sequence[str], cores: Sequence[int], variables: Mapping[str, str] | None = None
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
            result.append(Slot(gpu, tuple(own), per_device, variables or {}))
    return result


@contextlib.contextmanager
def worker_slots(plan: dict[str, Any], emit: Callable[[str], None]) -> Iterator[list[Slot | None]]:
    """Yield the slots where the groups of `plan` train at the same time; [None], this process's place, if one at a time.

    `plan` is that of the launcher with `per_device`. `emit` receives a line with the number of programs. MPS is on
    while several programs share a GPU; if it cannot be used, `emit` receives the cause and each GPU has one program.
    """
    per_device, groups = plan.get("per_device"), plan["groups"]
    if per_device is None or not groups:
        yield [None]
        return
    gpus, cores = visible_gpus(os.environ)[: len(groups)], own_cores()
    if per_device == "auto":
        tasks = {plan["runs"][name]["config"].get("env") for group in groups for name in group["runs"]}
        per_device = measured_programs(tasks, len(cores) / len(gpus)) if gpus else 1
    count = min(per_device, math.ceil(len(groups) / max(len(gpus), 1)))
    with contextlib.ExitStack() as stack:
        variables, how = {}, ""
        if gpus and count > 1:
            try:
                variables = stack.enter_context(mps())
                how = " through the MPS daemon started for them" if variables else " through the running MPS daemon"
            except MpsError as error:
                count, how = 1, f"; MPS cannot be used: {error}"
        slots = make_slots(count, gpus, cores, variables)
        host = f" on each of {len(gpus)} GPUs" if len(gpus) > 1 else " on the GPU" if gpus else ""
        emit(f"{_counted(count, 'program')} at a time{host}, {_counted(len(slots[0].cores), 'core')} each{how}")
        yield [*slots]


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' if number != 1 else ''}"


def require_valid(per_device: PerDevice, launcher: str, devices: int | None) -> None:
    """Check the option --per-device against the other options.

    Raises:
        ValueError: it is out of its interval, or goes with neither the launcher nor the number of devices.
    """
    if per_device is None:
        return
    if per_device != "auto" and not 1 <= per_device <= MOST:
        raise InputError(f"per_device must be auto, or a number from 1 to {MOST}, not {per_device}")
    if launcher != "local":
        raise InputError(
            f"--per-device goes with --launcher local, not {launcher}: a task of the array has one program group. "
            "To share the GPUs of a job, submit a job that calls earl-jax sweep --per-device"
        )
    if devices is not None:
        raise InputError(
            "--per-device puts several programs on a GPU, and --devices spreads a program over several; choose one of them"
        )


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
    names: list[str] = []
    for name in environment.get("CUDA_VISIBLE_DEVICES", ",".join(map(str, range(count)))).split(","):
        name = name.strip()
        valid = int(name) < count if name.isdigit() else count and name.startswith(("GPU-", "MIG-"))
        if not valid:  # CUDA reads no further
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
