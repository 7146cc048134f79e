"""Lanes on several devices of one or more hosts: every device runs the same program on its own lanes.

Lanes do not communicate, so programs are mapped explicitly (`shard_map`) and contain no collectives. Automatic
partitioning would gather the replay, which is indexed by lane.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from earl_jax.algos.learner.replay import Replay
from earl_jax.errors import InputError
from earl_jax.training.state import TrainState

LANES, REPLICATED = PartitionSpec("lanes"), PartitionSpec()
TIME_FIRST = PartitionSpec(None, "lanes")
"""The layout of the replay's arrays, whose first axis is time."""
_REPLAY: dict[str, Any] = {
    **dict.fromkeys(("state", "action", "flags", "reward", "index"), TIME_FIRST),
    "counts": LANES,
    "demos": REPLICATED,
    "row": REPLICATED,
    "first_row": REPLICATED,
    "oldest": LANES,
}
_TRAIN_STATE: dict[str, Any] = {"lanes": LANES, "replay": Replay(**_REPLAY), "step": REPLICATED}
TRAIN_STATE = TrainState(**_TRAIN_STATE)
"""The layout of a train state on a mesh."""


def lane_mesh(devices: int | None, lanes: int) -> Mesh | None:
    """Return the mesh of the first `devices` devices of all hosts, or None for one device.

    The default is one device, or all devices of all processes if there are several processes.

    Raises:
        ValueError: there are fewer devices, or `lanes` don't divide over them; the message gives numbers that would
            fit.
    """
    available = jax.devices()
    default = len(available) if jax.process_count() > 1 else 1
    count = default if devices is None else devices
    if not 1 <= count <= len(available):
        raise InputError(f"{count} devices requested, but {len(available)} available ({available[0].device_kind})")
    if lanes % count:
        lane_choices = sorted({max(count, lanes // count * count), (lanes // count + 1) * count})
        raise InputError(
            f"{lanes} lanes don't divide over {count} devices: take {' or '.join(map(str, lane_choices))} lanes, "
            f"or one of {', '.join(str(number) for number in range(1, count) if lanes % number == 0)} devices"
        )
    if count == 1:
        return None
    return jax.make_mesh((count,), ("lanes",), axis_types=(AxisType.Auto,), devices=available[:count])


def mapped(function: Callable, mesh: Mesh | None, in_specs: Sequence[Any], out_specs: Any) -> Callable:
    """Return `function` mapped over the devices of `mesh`, or `function` itself without a mesh.

    `in_specs`, one for each argument, and `out_specs` are partition specs or trees of them, as `shard_map` takes them.
    """
    if mesh is None:
        return function

    def call(*arguments):
        inputs, in_tree = jax.tree.flatten(arguments)
        outputs, out_tree = jax.tree.flatten(jax.eval_shape(function, *arguments))
        input_specs = _leaf_specs(tuple(in_specs), arguments)
        output_specs = _leaf_specs(out_specs, jax.tree.unflatten(out_tree, outputs))

        def run_locally(*local_inputs):
            empty = [_empty_part(leaf, spec, mesh.size) for leaf, spec in zip(inputs, input_specs, strict=True)]
            result = function(*jax.tree.unflatten(in_tree, _with_nonempty(empty, local_inputs)))
            return _nonempty(jax.tree.leaves(result))

        specs = [[spec for leaf, spec in zip(leaves, leaf_specs, strict=True) if leaf.size]
                 for leaves, leaf_specs in ((inputs, input_specs), (outputs, output_specs))]  # fmt: skip
        run = jax.shard_map(run_locally, mesh=mesh, in_specs=tuple(specs[0]), out_specs=specs[1], check_vma=False)
        empty = [_empty_part(leaf, REPLICATED, 1) for leaf in outputs]
        return jax.tree.unflatten(out_tree, _with_nonempty(empty, run(*_nonempty(inputs))))

    return call


def _leaf_specs(specs: Any, tree: Any) -> list[PartitionSpec]:
    """Return the spec of every leaf of `tree`; a spec in `specs` can apply to a whole branch."""
    spread = jax.tree.map(lambda spec, part: jax.tree.map(lambda _: spec, part), specs, tree, is_leaf=_is_spec)
    return jax.tree.leaves(spread, is_leaf=_is_spec)


def _is_spec(node: Any) -> bool:
    return isinstance(node, PartitionSpec)


def _nonempty(leaves: Sequence[Any]) -> list[Any]:
    """Return the leaves with elements: XLA for GPUs (jaxlib 0.11) crashes on an empty array on several devices."""
    return [leaf for leaf in leaves if leaf.size]


def _with_nonempty(leaves: Sequence[Any], nonempty: Sequence[Any]) -> list[Any]:
    """Return `leaves` with the leaves that have elements replaced by `nonempty`, in their order."""
    rest = iter(nonempty)
    return [next(rest) if leaf.size else leaf for leaf in leaves]


def _empty_part(leaf: Any, spec: PartitionSpec, count: int) -> Any:
    """Return the part of an empty leaf on one of `count` devices; a leaf with elements is returned unchanged."""
    if leaf.size:
        return leaf
    axes = (*spec, *[None] * (len(leaf.shape) - len(spec)))
    return jnp.zeros([size // count if axis else size for size, axis in zip(leaf.shape, axes, strict=True)], leaf.dtype)


def placed(tree: Any, mesh: Mesh | None, specs: Any = LANES) -> Any:
    """Return the arrays of `tree`, which every host has in full, on the devices of `mesh` by `specs`.

    `specs` is a partition spec, or a tree of them. Without a mesh, the arrays go to the default device.
    """
    if mesh is None:
        return jax.device_put(tree)

    def put_branch(spec, branch):
        put = functools.partial(_put, sharding=NamedSharding(mesh, spec))
        return jax.tree.map(put, branch)

    return jax.tree.map(put_branch, specs, tree, is_leaf=_is_spec)


def _put(leaf: Any, sharding: NamedSharding) -> jax.Array:
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(_put(jax.random.key_data(leaf), sharding))
    host = np.asarray(leaf)
    return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])
