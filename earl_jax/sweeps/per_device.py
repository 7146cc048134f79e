"""Several programs on each GPU: how many, at which slots, and through NVIDIA's MPS daemon."""

import contextlib
import os
from collections.abc import Callable, Iterator
from typing import Any, Literal, NamedTuple

from earl_jax.errors import InputError
from earl_jax.machine import own_cores
from earl_jax.sweeps.mps import MpsError, mps
from earl_jax.sweeps.packing_rates import measured_programs
from earl_jax.sweeps.slots import Slot, make_slots, needed, visible_gpus

PerDevice = int | Literal["auto"] | None
MOST = 48
"""The number of programs that MPS serves on a GPU."""


class WorkerOptions(NamedTuple):
    """What a worker has of its own: `arguments` of its command, and its `environment`, None for that of this process.

    With `neighbours`, several workers print: their lines are passed on as a whole, and none draws its progress.
    """

    arguments: tuple[str, ...] = ()
    environment: dict[str, str] | None = None
    neighbours: bool = False


ALONE = WorkerOptions()


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


@contextlib.contextmanager
def worker_slots(plan: dict[str, Any], emit: Callable[[str], None]) -> Iterator[list[WorkerOptions]]:
    """Yield the options of the workers that train the groups of `plan` at the same time, one for each slot.

    `plan` is that of the launcher with `per_device`. `emit` receives a line with the number of programs. MPS is on
    while several programs share a GPU; if it cannot be used, `emit` receives the cause and each GPU has one program.
    """
    per_device, groups = plan.get("per_device"), plan["groups"]
    if per_device is None or not groups:
        yield [ALONE]
        return
    gpus = visible_gpus(os.environ)[: len(groups)]
    count = needed(_programs(per_device, plan, len(gpus)), len(groups), len(gpus))
    with contextlib.ExitStack() as stack:
        variables, how = {}, ""
        if gpus and count > 1:
            try:
                variables = stack.enter_context(mps())
                how = " through the MPS daemon started for them" if variables else " through the running MPS daemon"
            except MpsError as error:
                count, how = 1, f"; MPS cannot be used: {error}"
        slots = make_slots(count, gpus, own_cores())
        emit(_summary(slots, len(gpus)) + how)
        yield [_options(slot, variables, neighbours=len(slots) > 1) for slot in slots]


def _programs(per_device: int | Literal["auto"], plan: dict[str, Any], gpus: int) -> int:
    """Return `per_device` as a number: the measured one of the tasks of `plan` for `auto`, 1 without a GPU."""
    if per_device != "auto":
        return per_device
    if not gpus:
        return 1
    tasks = {plan["runs"][name]["config"].get("env") for group in plan["groups"] for name in group["runs"]}
    return measured_programs(tasks, len(own_cores()) / gpus)


def _summary(slots: list[Slot], gpus: int) -> str:
    """Return the number of programs and cores of `slots` as text."""
    programs = _counted(slots[0].per_device, "program") + " at a time"
    host = f" on each of {gpus} GPUs" if gpus > 1 else " on the GPU" if gpus else ""
    return f"{programs}{host}, {_counted(len(slots[0].cores), 'core')} each"


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' if number != 1 else ''}"


def _options(slot: Slot, variables: dict[str, str], neighbours: bool) -> WorkerOptions:
    cores = tuple(map(str, slot.cores))
    return WorkerOptions(("--cores", *cores), slot.environment({**os.environ, **variables}), neighbours)
