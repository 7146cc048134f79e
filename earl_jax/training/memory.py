"""The memory of a run, computed before it starts."""

import dataclasses
import functools
import math
import os
import re
import shutil
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh

from earl_jax.algos import Method
from earl_jax.algos.method import controller_count
from earl_jax.errors import InputError
from earl_jax.options.environment import FRACTION, PER_DEVICE
from earl_jax.options.values import counted
from earl_jax.runs.checkpoint import saved_steps
from earl_jax.runs.contents import CHECKPOINTS
from earl_jax.runs.files import warn
from earl_jax.training.init import empty_replay, init_train_state
from earl_jax.training.state import Problem, TrainState

ACTIVATIONS = 1.5
"""Numbers in memory during a gradient step per row of the batch and per layer output in the agent, including its
targets and Adam's moments; measured: 1.0 to 1.3 with SAC (temporary_mb of benchmarks/results/speed)."""
RUNTIME = 450_000_000
"""Bytes that a process on a CPU needs to compile and run a small program, in addition to the estimate; measured."""
GIGABYTE = 1e9
PROC, GROUPS = Path("/proc"), Path("/sys/fs/cgroup")


@dataclasses.dataclass(frozen=True)
class MemoryEstimate:
    """Bytes of one lane: its `replay`, `agent` (with the rest of its state), and `work` during a gradient step."""

    lanes: int
    replay: int
    agent: int
    work: int

    @property
    def lane(self) -> int:
        """Bytes of one lane."""
        return self.replay + self.agent + self.work

    @property
    def total(self) -> int:
        """Bytes of all lanes."""
        return self.lanes * self.lane

    def __str__(self) -> str:
        each, verb = (" each", "take") if self.lanes > 1 else ("", "takes")
        return (
            f"{counted(self.lanes, 'lane')} {verb} {self.total / GIGABYTE:.3g} GB: {self.replay / 1e6:.0f} MB of replay, "
            f"{self.agent / 1e6:.0f} MB of agent and {self.work / 1e6:.0f} MB of work{each}"
        )


def replay_bytes(problem: Problem, method: Method, steps: int) -> int:
    """Return the bytes of one lane's replay for `steps` steps."""
    return _bytes(jax.eval_shape(functools.partial(empty_replay, problem, method, 1, steps)))


def estimate(problem: Problem, method: Method, lanes: int, steps: int) -> MemoryEstimate:
    """Return the memory that `lanes` lanes of `steps` steps need."""
    replay = replay_bytes(problem, method, steps)  # first, since it refuses tasks without demonstrations
    single = jax.tree.map(lambda leaf: jnp.zeros((1,), jnp.result_type(leaf)), method)  # sizes depend on no values
    shape = _one_lane.eval_shape(problem, single, jax.random.key(0), steps=1)
    outputs = _layer_outputs(shape.lanes.agent) // controller_count(method)
    return MemoryEstimate(
        lanes,
        replay=replay,
        agent=_bytes(shape.lanes),
        work=int(4 * ACTIVATIONS * method.learner.batch_size * outputs),
    )


@functools.partial(jax.jit, static_argnames=("problem", "steps"))
def _one_lane(problem: Problem, method: Method, key: jax.Array, steps: int) -> TrainState:
    """Return the first train state of a lane, under `jit` so that Python traces it once for all runs of a problem."""
    return init_train_state(problem, method, key[None], steps)


def _layer_outputs(agent: Any) -> int:
    """Return the number of outputs of all layers in `agent`, counted from the leaves that flax calls `kernel`."""
    leaves = jax.tree_util.tree_leaves_with_path(agent)
    kernels = [leaf for path, leaf in leaves if "kernel" in jax.tree_util.keystr(path[-1:])]
    return sum(math.prod(kernel.shape) // kernel.shape[-2] for kernel in kernels)


def _bytes(tree: Any) -> int:
    return sum(math.prod(leaf.shape) * (leaf.dtype.itemsize or 8) for leaf in jax.tree.leaves(tree))


def programs_per_device() -> int:
    """Return the number of programs that share the device, of which this process is one."""
    text = os.environ.get(PER_DEVICE, "1")
    return max(1, int(text)) if text.isdecimal() else 1


def free_bytes(device: Any) -> int | None:
    """Return the bytes that are free on `device` for this process, or None if that is unknown.

    On a GPU, jax gives each process the fraction `FRACTION` of the memory. Programs that share a CPU get equal shares
    of the machine's memory, or of the lowest limit of their control groups, which includes the process itself.
    """
    stats = device.memory_stats()
    if stats and "bytes_limit" in stats:
        return stats["bytes_limit"] - stats.get("bytes_in_use", 0)
    if device.platform != "cpu" or not (PROC / "meminfo").is_file():
        return None
    whole, programs = _counted("meminfo", "MemTotal"), programs_per_device()
    own = _counted("self/status", "RssAnon") + RUNTIME
    group = max(0, min(_group_limits(), default=whole) // programs - own)
    return min(_counted("meminfo", "MemAvailable") or whole, whole // programs, group)


def _group_limits() -> list[int]:
    """Return the memory limits of the control groups (version 1 or 2) to which this process belongs."""
    limits, groups = [], PROC / "self/cgroup"
    for line in groups.read_text().splitlines() if groups.is_file() else []:
        _, kinds, name = line.split(":", 2)
        if kinds in ("", "memory"):
            group = GROUPS / kinds / name.lstrip("/")
            files = [folder / f"memory.{'limit_in_bytes' if kinds else 'max'}" for folder in (group, *group.parents)]
            texts = [file.read_text().strip() for file in files if file.is_file()]
            limits += [int(text) for text in texts if text != "max"]
    return limits


def _counted(file: str, name: str) -> int:
    """Return the bytes in the line `name` of the system's `file`, which counts in kB; 0 without such a line."""
    found = re.search(rf"^{name}:\s+([0-9]+) kB", (PROC / file).read_text(), re.MULTILINE)
    return 1024 * int(found[1]) if found else 0


def warn_of_disk(needed: MemoryEstimate, folder: Path) -> None:
    """Warn if the disk of `folder`, that of a run, has less space than the checkpoints of its program can need.

    There are three while the last one is written. A run that is continued has two of them.
    """
    copies = 1 if saved_steps(folder / CHECKPOINTS) else 3
    size, free = copies * needed.lanes * (needed.replay + needed.agent), shutil.disk_usage(folder).free
    if size > free:
        sizes = f"{size / GIGABYTE:.3g} GB, and the disk of {folder} has {free / GIGABYTE:.3g} GB"
        warn(f"the checkpoints of {counted(needed.lanes, 'lane')} can need {sizes}; training ends when it is full")


def require(needed: MemoryEstimate, mesh: Mesh | None = None) -> None:
    """Check that a program fits into the memory of one device, or of the devices of `mesh`.

    Raises:
        ValueError: the lanes of one device need more memory than is free there; the message says how many would fit.
    """
    devices = [jax.devices()[0]] if mesh is None else mesh.local_devices
    count = 1 if mesh is None else mesh.size
    sharing = len(devices) if devices[0].platform == "cpu" else 1
    free = min((free // sharing for device in devices if (free := free_bytes(device)) is not None), default=None)
    if free is None or needed.total <= free * count:
        return
    have, each = ("the device has", "") if count == 1 else (f"{count} devices have", " each")
    fitting = counted(free // needed.lane * count, "lane")
    remedy = (
        f"Use fewer seeds or steps, more devices, a larger limit of this job's or container's memory, "
        f"or on a GPU a larger {FRACTION}, such as 0.95"
    )
    if (programs := programs_per_device()) > 1:
        remedy = (
            f"This is the share of one of {programs} programs; use --per-device {programs // 2} or another smaller "
            "number, a smaller --max-lanes, or fewer seeds or steps"
        )
    raise InputError(f"{needed}, but {have} {free / GIGABYTE:.3g} GB{each} free: {fitting} would fit. {remedy}")
