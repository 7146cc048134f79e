"""The barrier in MJX's kinematics: present once where it is needed, absent elsewhere."""

import importlib
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.physics import mjx_compat


@pytest.mark.skipif(not mjx_compat.needs_guard(), reason="XLA compiles MJX's kinematics fast here")
def test_a_step_on_mjx_has_the_barrier_on_the_carry_of_body_tree_once():
    env = make("minitaur_pen", engine="mjx")
    state = jax.eval_shape(env.reset, jax.random.key(0))
    assert "optimization_barrier" in str(jax.make_jaxpr(env.step)(state, jnp.zeros(env.action_size)))
    scan = importlib.import_module("mujoco.mjx._src.scan")
    guarded = scan.body_tree
    assert not hasattr(guarded.__wrapped__, "__wrapped__")
    mjx_compat.guard_kinematics()
    assert scan.body_tree is guarded


@pytest.mark.parametrize(("version", "backend"), [(mjx_compat.FIXED_JAXLIB, "cpu"), ((0, 10), "gpu")])
def test_a_jaxlib_without_the_slow_fusion_and_an_accelerator_are_left_alone(monkeypatch, version, backend):
    monkeypatch.setattr(mjx_compat.jaxlib.version, "__version_info__", version)
    monkeypatch.setattr(mjx_compat, "default_backend", lambda: backend)
    assert not mjx_compat.needs_guard()


@pytest.mark.parametrize("sizes", [[3, 3], [4, 1, 4, 3], [6], [1]])
def test_the_sum_over_contacts_is_the_product_with_the_matrix_of_all_rows(sizes):
    """Contacts with `sizes` rows, and the sum as MJX forms it."""
    first, total, rng = 3, 3 + sum(sizes) + 1, np.random.default_rng(3)
    addresses = first + np.cumsum([0, *sizes[:-1]])
    jacobian = rng.normal(size=(total, 4)).astype(np.float32)
    cones = rng.normal(size=(sum(size > 1 for size in sizes), 6, 6)).astype(np.float32)
    matrix, cone = np.zeros((total, total)), iter(cones)
    for size, start in zip(sizes, addresses, strict=True):
        if size > 1:
            matrix[start : start + size, start : start + size] = next(cone)[:size, :size]
    contact = types.SimpleNamespace(dim=np.array(sizes), efc_address=addresses)
    hessian = jax.jit(lambda *arrays: mjx_compat._cone_hessian(arrays[0], contact, arrays[1]))(jacobian, cones)
    np.testing.assert_allclose(hessian, jacobian.T @ matrix @ jacobian, atol=1e-4)
