"""Lanes on several devices of one or more hosts: every device runs the same program on its own lanes.

Lanes do not communicate, so programs are mapped explicitly (`shard_map`) and contain no collectives. Automatic
partitioning would gather the replay, because it is indexed by lane.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from earl_jax.algos.learner.replay import Replay
from earl_jax.errors import InputError
from earl_jax.options.values import COUNT, counted, require
from earl_jax.training.state import TrainState

LANES: Any = PartitionSpec("lanes")
REPLICATED: Any = PartitionSpec()
TIME_FIRST: Any = PartitionSpec(None, "lanes")
"""The layout of the replay's arrays, whose first axis is time."""
_REPLAY = Replay(
    state=TIME_FIRST,
    action=TIME_FIRST,
    flags=TIME_FIRST,
    reward=TIME_FIRST,
    index=TIME_FIRST,
    counts=LANES,
    demos=REPLICATED,
    row=REPLICATED,
    first_row=REPLICATED,
    oldest=LANES,
)
TRAIN_STATE = TrainState(lanes=LANES, replay=_REPLAY, step=REPLICATED)
"""The layout of a train state on a mesh."""


def lane_mesh(devices: int | None, lanes: int) -> Mesh | None:
    """Return the mesh of the first `devices` devices of all hosts, or None for one device.

    The default is one device, or all devices of all processes if there are several processes.

    Raises:
        ValueError: there are fewer devices, some hosts have none of them, or `lanes` can't be divided over them; the
            message gives numbers that would fit.
    """
    available = jax.devices()
    default = len(available) if jax.process_count() > 1 else 1
    count = default if devices is None else devices
    require("devices", count, COUNT)
    if count > len(available):
        raise InputError(f"{count} devices requested, but {len(available)} available ({available[0].device_kind})")
    if lanes % count:
        lane_choices = sorted({max(count, lanes // count * count), (lanes // count + 1) * count})
        raise InputError(
            f"{counted(lanes, 'lane')} can't be divided over {count} devices: take {' or '.join(map(str, lane_choices))} lanes, "
            f"or {' or '.join(str(number) for number in range(1, count) if lanes % number == 0)} of the devices"
        )
    chosen, hosts = available[:count], jax.process_count()
    if len({device.process_index for device in chosen}) < hosts:
        raise InputError(f"the first {count} of {len(available)} devices are not on all {hosts} hosts: request more")
    return None if count == 1 else jax.make_mesh((count,), ("lanes",), axis_types=(AxisType.Auto,), devices=chosen)


def mapped(function: Callable, mesh: Mesh | None, in_specs: Any, out_specs: Any) -> Callable:
    """Return `function` mapped over the devices of `mesh`, or `function` itself without a mesh.

    `in_specs`, one for each argument, and `out_specs` are partition specs or trees of them, as for `shard_map`. Empty
    arrays are kept out of the mapping: XLA for GPUs (jaxlib 0.11) crashes on them with several devices.
    """
    if mesh is None:
        return function

    def call(*arguments):
        specs = jax.tree.broadcast(in_specs, arguments)

        def local_shape(leaf, spec):
            return jax.ShapeDtypeStruct(NamedSharding(mesh, spec).shard_shape(leaf.shape), leaf.dtype)

        def run_locally(*parts):
            return _without_empty(function(*_with_empty(parts, jax.tree.map(local_shape, arguments, specs))))

        run = jax.shard_map(run_locally, mesh=mesh, in_specs=in_specs, out_specs=out_specs, check_vma=False)
        return _with_empty(run(*_without_empty(arguments)), jax.eval_shape(function, *arguments))

    return call


def placed(tree: Any, mesh: Mesh | None, specs: Any = LANES) -> Any:
    """Return the arrays of `tree`, which every host holds in full, placed on the devices of `mesh` by `specs`.

    `specs` is a partition spec, or a tree of them. Without a mesh, the arrays go to the default device.
    """
    if mesh is None:
        return jax.device_put(tree)
    specs = jax.tree.broadcast(specs, tree)
    return jax.tree.map(lambda leaf, spec: _put(leaf, NamedSharding(mesh, spec)), tree, specs)


def _without_empty(tree: Any) -> Any:
    """Return `tree` with None in place of arrays that have no elements."""
    return jax.tree.map(lambda leaf: leaf if leaf.size else None, tree)


def _with_empty(tree: Any, shapes: Any) -> Any:
    """Return `tree` with the empty arrays that `_without_empty` removed, recreated from `shapes`."""
    return jax.tree.map(lambda shape, leaf: leaf if shape.size else jnp.zeros(shape.shape, shape.dtype), shapes, tree)


def _put(leaf: Any, sharding: NamedSharding) -> jax.Array:
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(_put(jax.random.key_data(leaf), sharding))
    host = np.asarray(leaf)
    return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])
