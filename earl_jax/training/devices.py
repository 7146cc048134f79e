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
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from earl_jax.algos.learner.replay import Replay
from earl_jax.training.state import TrainState

LANES, REPLICATED = PartitionSpec("lanes"), PartitionSpec()
TIME_FIRST = PartitionSpec(None, "lanes")
"""For the replay's arrays, whose first axis is time."""
_REPLAY: dict[str, Any] = {
    **dict.fromkeys(("state", "action", "flags", "reward", "index"), TIME_FIRST),
    "counts": LANES,
    "demos": REPLICATED,
    "row": REPLICATED,
}
_TRAIN_STATE: dict[str, Any] = {"lanes": LANES, "replay": Replay(**_REPLAY), "step": REPLICATED}
TRAIN_STATE = TrainState(**_TRAIN_STATE)
"""How a train state is laid out on a mesh."""


def lane_mesh(devices: int | None, lanes: int) -> Mesh | None:
    """Return the mesh of the first `devices` devices of all hosts, or None for one device.

    Without a number it is one device, or, where this process is one of several, all of theirs.

    Raises:
        ValueError: there are fewer, or `lanes` don't divide over them; the message says what would fit.
    """
    available = jax.devices()
    count = devices or (len(available) if jax.process_count() > 1 else 1)
    if not 1 <= count <= len(available):
        raise ValueError(f"{count} devices asked for, and there are {len(available)} ({available[0].device_kind})")
    if lanes % count:
        fitting = sorted({max(count, lanes // count * count), (lanes // count + 1) * count})
        raise ValueError(
            f"{lanes} lanes don't divide over {count} devices: take {' or '.join(map(str, fitting))} lanes, "
            f"or one of {', '.join(str(number) for number in range(1, count) if lanes % number == 0)} devices"
        )
    if count == 1:
        return None
    return jax.make_mesh((count,), ("lanes",), axis_types=(AxisType.Auto,), devices=available[:count])


def mapped(function: Callable, mesh: Mesh | None, takes: Sequence[Any], gives: Any) -> Callable:
    """Return `function` run by every device of `mesh` on its share of what `takes` and `gives` say; unchanged without one."""
    if mesh is None:
        return function

    def call(*arguments):
        given, into = jax.tree.flatten(arguments)
        promised, out = jax.tree.flatten(jax.eval_shape(function, *arguments))
        takes_each, gives_each = _each(tuple(takes), arguments), _each(gives, jax.tree.unflatten(out, promised))

        def share(*some):
            local = [_empty(leaf, spec, mesh.size) for leaf, spec in zip(given, takes_each, strict=True)]
            result = function(*jax.tree.unflatten(into, _filled(local, some)))
            return _sized(jax.tree.leaves(result))

        specs = [[spec for leaf, spec in zip(leaves, each, strict=True) if leaf.size]
                 for leaves, each in ((given, takes_each), (promised, gives_each))]  # fmt: skip
        run = jax.shard_map(share, mesh=mesh, in_specs=tuple(specs[0]), out_specs=specs[1], check_vma=False)
        whole = [_empty(leaf, REPLICATED, 1) for leaf in promised]
        return jax.tree.unflatten(out, _filled(whole, run(*_sized(given))))

    return call


def _each(specs: Any, tree: Any) -> list[PartitionSpec]:
    """Return the spec of every leaf of `tree`, where `specs` may speak for whole branches."""
    spread = jax.tree.map(lambda spec, part: jax.tree.map(lambda _: spec, part), specs, tree, is_leaf=_is_spec)
    return jax.tree.leaves(spread, is_leaf=_is_spec)


def _is_spec(node: Any) -> bool:
    return isinstance(node, PartitionSpec)


def _sized(leaves: Sequence[Any]) -> list[Any]:
    """Return the leaves that hold anything: XLA for GPUs (jaxlib 0.11) crashes on an empty array spread over devices."""
    return [leaf for leaf in leaves if leaf.size]


def _filled(leaves: Sequence[Any], sized: Sequence[Any]) -> list[Any]:
    """Return `leaves` with those that hold anything replaced by `sized`, in their order."""
    rest = iter(sized)
    return [next(rest) if leaf.size else leaf for leaf in leaves]


def _empty(leaf: Any, spec: PartitionSpec, count: int) -> Any:
    """Return an empty leaf as one of `count` devices has it; one that holds anything is left as it is, to be replaced."""
    if leaf.size:
        return leaf
    axes = (*spec, *[None] * (len(leaf.shape) - len(spec)))
    return jnp.zeros([size // count if axis else size for size, axis in zip(leaf.shape, axes, strict=True)], leaf.dtype)


def placed(tree: Any, mesh: Mesh | None, specs: Any = LANES) -> Any:
    """Return the arrays of `tree`, whole on every host, laid out on `mesh` by `specs` (one for all, or a tree of them).

    Without a mesh they go to the one device.
    """
    if mesh is None:
        return jax.device_put(tree)

    def place(spec, part):
        put = functools.partial(_place, sharding=NamedSharding(mesh, spec))
        return jax.tree.map(put, part)

    return jax.tree.map(place, specs, tree, is_leaf=_is_spec)


def _place(leaf: Any, sharding: NamedSharding) -> jax.Array:
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(_place(jax.random.key_data(leaf), sharding))
    host = np.asarray(leaf)
    return jax.make_array_from_callback(host.shape, sharding, lambda index: host[index])
