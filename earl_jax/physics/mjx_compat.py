"""Two workarounds for slow programs of MuJoCo MJX; no other module uses MJX's private modules.

XLA's CPU compiler fuses MJX's scan along a chain of bodies and recomputes every parent in each child. The cost is
exponential in the length of the chain: 248 ms instead of 0.4 ms for one step of the Sawyer arm. An optimization barrier
on the scan's carry prevents the fusion and changes no value. The second workaround is `sum_cones_by_contact`.
"""

import functools
import importlib
from typing import Any

import jax
import jax.numpy as jnp
import jaxlib.version
import numpy as np
from jax import default_backend

FIXED_JAXLIB = (0, 12)
"""The first release of jaxlib that was measured to be as fast without the barrier."""


@functools.cache
def guard_kinematics() -> None:
    """Add a barrier to MJX's `scan.body_tree`, once and only if this process needs it."""
    if not needs_guard():
        return
    scan: Any = importlib.import_module("mujoco.mjx._src.scan")
    body_tree = scan.body_tree

    @functools.wraps(body_tree)
    def guarded(model: Any, f: Any, *rest: Any, **options: Any) -> Any:
        return body_tree(model, lambda carry, *args: f(jax.lax.optimization_barrier(carry), *args), *rest, **options)

    scan.body_tree = guarded


def needs_guard() -> bool:
    """Return whether programs run on a CPU under a release of jaxlib with the slow fusion."""
    return default_backend() == "cpu" and jaxlib.version.__version_info__ < FIXED_JAXLIB


@functools.cache
def sum_cones_by_contact() -> None:
    """Let MJX's Newton solver add the Hessian of each friction cone to that of the joints, in one product for all.

    MJX writes the cones one after another into a matrix of all constraint rows, and a GPU copies that matrix of every
    lane each time: 22 of 31 ms of a control step of 500 lanes of the Sawyer door.
    """
    solver: Any = importlib.import_module("mujoco.mjx._src.solver")
    original = solver._update_gradient

    @functools.wraps(original)
    def update_gradient(model: Any, data: Any, context: Any) -> Any:
        newton = model.opt.solver == solver.SolverType.NEWTON
        if not newton or model.opt.cone != solver.ConeType.ELLIPTIC:
            return original(model, data, context)
        jacobian, weights = data._impl.efc_J, data._impl.efc_D * context.active
        hessian = solver.support.full_m(model, data) + (jacobian.T * weights) @ jacobian
        hessian = hessian + _cone_hessian(jacobian, data._impl.contact, context.h)
        grad = context.Ma - data.qfrc_smooth - context.qfrc_constraint
        factor = jax.scipy.linalg.cho_factor((hessian + hessian.T) / 2)
        return context.replace(grad=grad, Mgrad=jax.scipy.linalg.cho_solve(factor, grad))

    solver._update_gradient = update_gradient


def _cone_hessian(jacobian: jax.Array, contact: Any, cones: jax.Array) -> jax.Array:
    """Return the part [nv, nv] of the friction cones, given their Hessians `cones [n, 6, 6]` by constraint rows."""
    sizes, rows = contact.dim[contact.dim > 1], contact.efc_address[contact.dim > 1]
    total = jnp.zeros((jacobian.shape[1],) * 2)
    for size in np.unique(sizes):
        chosen = np.flatnonzero(sizes == size)
        block = jacobian[rows[chosen][:, None] + np.arange(size)]
        curved = jnp.einsum("nij,njk->nik", cones[chosen, :size, :size], block)
        total = total + jnp.einsum("nij,nik->jk", block, curved)
    return total
