"""MJX, its own JAX implementation or Warp's: one program for all lanes."""

import contextlib
import functools
import importlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from earl_jax.physics.models import import_mjx
from earl_jax.physics.state import FIELDS, Integration

if TYPE_CHECKING:
    from earl_jax.physics import Simulator

WARP_CONTACTS, WARP_ROWS = 1 << 15, 256
"""Room that Warp gets: contacts of all lanes together, constraint rows of one. Where it runs out the state becomes NaN."""


@functools.cache
def _model(simulator: "Simulator") -> tuple[Any, Any]:
    mjx, host = import_mjx(), simulator.mujoco_model()
    implementation = "warp" if simulator.engine == "warp" else "jax"
    budget = {"naconmax": WARP_CONTACTS, "njmax": WARP_ROWS} if implementation == "warp" else {}
    with jax.ensure_compile_time_eval():
        model = mjx.put_model(host, impl=implementation)
        if implementation == "warp":
            model = model.tree_replace({"opt._impl.warn_overflow": 0})
        return model, mjx.make_data(host, impl=implementation, **budget)


def step(simulator: "Simulator", state: Integration, command: jax.Array) -> tuple[Integration, jax.Array]:
    """Return what `Simulator.step` promises; the scan carries the integration state, so the rest of `Data` is dead."""
    mjx, (model, blank) = import_mjx(), _model(simulator)
    if simulator.varied:
        model = model.tree_replace(simulator.variation(state.constants))

    def substep(carry, _):
        state = carry[0]
        ctrl, memory = simulator.controls(jnp, state.qpos, state.qvel, command, state.memory)
        data = blank.replace(ctrl=ctrl, **{field: getattr(state, field) for field in FIELDS})
        data = mjx.step(model, data)
        after = state.replace(memory=memory, **{field: getattr(data, field) for field in FIELDS})
        if simulator.engine == "warp":
            after = after.replace(qpos=jnp.where(_warp_overflowed(data), jnp.nan, after.qpos))
        return (after, data.sensordata), None

    with _guarded_kinematics(), jax.default_matmul_precision("highest"):
        return jax.lax.scan(substep, (state, blank.sensordata), length=simulator.substeps)[0]


def _warp_overflowed(data: Any) -> jax.Array:
    """Return whether contacts or rows of a Warp step did not fit: it drops them without a word."""
    return (data._impl.nacon > WARP_CONTACTS).any() | (data._impl.nefc > WARP_ROWS).any()


@contextlib.contextmanager
def _guarded_kinematics() -> Iterator[None]:
    """While tracing, keep XLA from fusing MJX's walk along a chain of bodies into itself.

    XLA:CPU of jax 0.10 recomputes every parent in each child, exponentially often (248 ms for what takes 0.4); a barrier on
    the carry stops it and costs nothing elsewhere.
    """
    scan: Any = importlib.import_module("mujoco.mjx._src.scan")
    body_tree = scan.body_tree

    def guarded(model, f, *rest, **options):
        return body_tree(model, lambda carry, *args: f(jax.lax.optimization_barrier(carry), *args), *rest, **options)

    scan.body_tree = guarded
    try:
        yield
    finally:
        scan.body_tree = body_tree
