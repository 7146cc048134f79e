"""MJX in its JAX or its Warp implementation: one program simulates all lanes."""

import functools
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from earl_jax.physics.mjx_compat import guard_kinematics, sum_cones_by_contact
from earl_jax.physics.models import import_mjx
from earl_jax.physics.state import FIELDS, PhysicsState

if TYPE_CHECKING:
    from earl_jax.physics import Simulator

WARP_CONTACTS, WARP_ROWS = 1 << 15, 256
"""Warp's capacity: the contacts of all lanes, and the constraint rows of one lane. On overflow the state becomes
NaN."""


@functools.cache
def _model(simulator: "Simulator") -> tuple[Any, Any]:
    mjx, host = import_mjx(), simulator.mujoco_model()
    with jax.ensure_compile_time_eval():
        if simulator.engine == "mjx":
            return mjx.put_model(host, impl="jax"), mjx.make_data(host, impl="jax")
        model = mjx.put_model(host, impl="warp").tree_replace({"opt._impl.warn_overflow": 0})
        return model, mjx.make_data(host, impl="warp", naconmax=WARP_CONTACTS, njmax=WARP_ROWS)


@functools.partial(jax.jit, static_argnums=0)
def step(simulator: "Simulator", state: PhysicsState, command: jax.Array) -> tuple[PhysicsState, jax.Array]:
    """Return the result of `Simulator.step`. It is under `jit`, so that Python traces MJX once for all programs with it.

    The scan carries the integration state only, so XLA removes the rest of `Data`. Its first sensor values, which
    nothing reads, depend on the state: JAX traces a batch of lanes twice if a part of the carry has lanes only at the end.
    """
    mjx, (model, empty_data) = import_mjx(), _model(simulator)
    if simulator.varied:
        model = model.tree_replace(simulator.variation(state.constants))

    def substep(carry, _):
        state = carry[0]
        ctrl, memory = command, state.memory
        if simulator.actuator is not None:
            ctrl, memory = simulator.actuator(jnp, state.qpos, state.qvel, command, memory)
        data = empty_data.replace(ctrl=ctrl, **{field: getattr(state, field) for field in FIELDS})
        data = mjx.step(model, data)
        after = state.replace(memory=memory, **{field: getattr(data, field) for field in FIELDS})
        if simulator.engine == "warp":  # it silently drops contacts or rows beyond its capacity
            overflowed = (data._impl.nacon > WARP_CONTACTS).any() | (data._impl.nefc > WARP_ROWS).any()
            after = after.replace(qpos=jnp.where(overflowed, jnp.nan, after.qpos))
        return (after, data.sensordata), None

    guard_kinematics()
    sum_cones_by_contact()
    with jax.default_matmul_precision("highest"):
        sensors = jnp.full_like(empty_data.sensordata, state.qpos[0])
        return jax.lax.scan(substep, (state, sensors), length=simulator.substeps)[0]
