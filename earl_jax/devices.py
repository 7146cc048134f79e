"""Lanes over several devices, of one host or of many: every device runs the same program on its own lanes.

Lanes never talk, so the programs are mapped by hand (`shard_map`) and hold no collective at all. Automatic partitioning would
gather the replay, which is indexed by lane.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from earl_jax.algos.autonomy import Lives
from earl_jax.algos.replay import Replay

LANES, ALIKE = PartitionSpec("lanes"), PartitionSpec()
LATER = PartitionSpec(None, "lanes")
"""Of the replay's arrays, whose first axis is time."""
_REPLAY: dict[str, Any] = {
    "state": LATER, "action": LATER, "marks": LATER, "reward": LATER, "index": LATER, "counts": LANES, "demos": ALIKE,
    "row": ALIKE,
}  # fmt: skip
_LIVES: dict[str, Any] = {"lanes": LANES, "replay": Replay(**_REPLAY), "step": ALIKE}
LIVES = Lives(**_LIVES)
"""How lives lie on a mesh."""


def lane_mesh(devices: int | None, lanes: int) -> Mesh | None:
    """Return the mesh of the first `devices` devices of all hosts, or None for one device.

    Without a number it is one device, or, where this process is one of several, all of theirs.

    Raises:
        ValueError: there are fewer, or `lanes` don't divide over them; the message says what would fit.
    """
    found = jax.devices()
    count = devices or (len(found) if jax.process_count() > 1 else 1)
    if not 1 <= count <= len(found):
        raise ValueError(f"{count} devices asked for, and there are {len(found)} ({found[0].device_kind})")
    if lanes % count:
        fitting = sorted({max(count, lanes // count * count), (lanes // count + 1) * count})
        raise ValueError(
            f"{lanes} lanes don't divide over {count} devices: take {' or '.join(map(str, fitting))} lanes, "
            f"or one of {', '.join(str(number) for number in range(1, count) if lanes % number == 0)} devices"
        )
    if count == 1:
        return None
    return jax.make_mesh((count,), ("lanes",), axis_types=(AxisType.Auto,), devices=found[:count])


def mapped(function: Callable, mesh: Mesh | None, takes: Sequence[Any], gives: Any) -> Callable:
    """Return `function` run by every device of `mesh` on its share of what `takes` and `gives` say; unchanged without one."""
    if mesh is None:
        return function
    return jax.shard_map(function, mesh=mesh, in_specs=tuple(takes), out_specs=gives, check_vma=False)


def placed(tree: Any, mesh: Mesh | None, specs: Any = LANES) -> Any:
    """Return the arrays of `tree`, whole on every host, laid out on `mesh` by `specs` (one for all, or a tree of them)."""
    if mesh is None:
        return tree

    def place(spec, part):
        put = functools.partial(_place, sharding=NamedSharding(mesh, spec))
        return jax.tree.map(put, part)

    return jax.tree.map(place, specs, tree, is_leaf=lambda leaf: isinstance(leaf, PartitionSpec))


def _place(leaf: Any, sharding: NamedSharding) -> jax.Array:
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(_place(jax.random.key_data(leaf), sharding))
    host = np.asarray(leaf)
    return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])


def gathered(tree: Any) -> Any:
    """Return the arrays of `tree` as NumPy's, also those whose lanes live on other hosts; every host must ask."""

    def gather(leaf):
        if isinstance(leaf, jax.Array) and not leaf.is_fully_addressable:
            if leaf.is_fully_replicated:
                return np.asarray(leaf.addressable_data(0))
            return np.asarray(multihost_utils.process_allgather(leaf, tiled=True))
        return np.asarray(leaf)

    return jax.tree.map(gather, tree)


def join_hosts(address: str | None, hosts: int | None, number: int | None) -> None:
    """Make this process one of several that run one program; a cluster that jax knows (SLURM, Open MPI) needs no arguments."""
    jax.distributed.initialize(address, hosts, number)


def first_host() -> bool:
    """Return whether this process is the one that writes."""
    return jax.process_index() == 0
