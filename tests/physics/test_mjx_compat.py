"""The barrier in MJX's kinematics: present once where it is needed, absent elsewhere."""

import importlib
import types
from importlib import metadata

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import make
from earl_jax.physics import mjx_compat


@pytest.fixture
def fake_scan(monkeypatch):
    """A module with a `body_tree` of its own, in place of MJX's `scan`."""
    scan = types.SimpleNamespace(body_tree=lambda model, f, *args: f(*args))
    import_module = importlib.import_module
    modules = {"mujoco.mjx._src.scan": scan}
    monkeypatch.setattr(importlib, "import_module", lambda name, *rest: modules.get(name) or import_module(name, *rest))
    return scan


@pytest.fixture
def affected(monkeypatch):
    """A release of jaxlib with the slow fusion, on a CPU."""
    monkeypatch.setattr(mjx_compat, "_jaxlib_version", lambda: mjx_compat.AFFECTED_JAXLIB)


needs_guard = pytest.mark.skipif(not mjx_compat.needs_guard(), reason="XLA compiles MJX's kinematics fast here")


@needs_guard
def test_a_step_on_mjx_puts_the_barrier_into_body_tree_once():
    env = make("fish_swim", engine="mjx")
    state = jax.eval_shape(env.reset, jax.random.key(0))
    jax.eval_shape(env.step, state, jnp.zeros(env.action_size))
    scan = importlib.import_module("mujoco.mjx._src.scan")
    assert mjx_compat.is_guarded(scan)
    guarded = scan.body_tree
    assert not hasattr(guarded.__wrapped__, "__wrapped__")
    assert mjx_compat.guard_kinematics()
    assert scan.body_tree is guarded


def test_the_barrier_guards_the_carry_and_changes_no_value(fake_scan, affected):
    def run(carry):
        return fake_scan.body_tree(None, lambda carry, offset: 2 * carry + offset, carry, 1.0)

    def barriers():
        return str(jax.make_jaxpr(lambda carry: run(carry))(jnp.arange(3.0))).count("optimization_barrier")

    assert barriers() == 0
    assert mjx_compat.guard_kinematics()
    assert barriers() == 1
    assert mjx_compat.guard_kinematics()
    assert barriers() == 1
    np.testing.assert_array_equal(run(jnp.arange(3.0)), [1, 3, 5])


def test_a_release_without_body_tree_is_an_import_error_that_names_the_version(fake_scan, affected):
    del fake_scan.body_tree
    with pytest.raises(ImportError, match=f"mujoco-mjx {metadata.version('mujoco-mjx')} has no scan.body_tree"):
        mjx_compat.guard_kinematics()


@pytest.mark.parametrize("version", [(0, 9), mjx_compat.FIXED_JAXLIB])
def test_a_jaxlib_without_the_slow_fusion_is_left_alone(fake_scan, monkeypatch, version):
    monkeypatch.setattr(mjx_compat, "_jaxlib_version", lambda: version)
    assert not mjx_compat.guard_kinematics()
    assert not mjx_compat.is_guarded(fake_scan)


def test_an_accelerator_is_left_alone(fake_scan, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert not mjx_compat.guard_kinematics()
    assert not mjx_compat.is_guarded(fake_scan)


def cone_rows(sizes, key):
    """Return the constraint rows, the contacts and the cones of contacts with `sizes` rows, and the sum as MJX forms it."""
    first, total, joints = 3, 3 + sum(sizes) + 1, 4
    addresses = first + np.cumsum([0, *sizes[:-1]])
    rows_key, cone_key = jax.random.split(key)
    jacobian = jax.random.normal(rows_key, (total, joints))
    cones = jax.random.normal(cone_key, (sum(size > 1 for size in sizes), 6, 6))
    matrix, cone = np.zeros((total, total)), iter(np.asarray(cones))
    for size, start in zip(sizes, addresses, strict=True):
        if size > 1:
            matrix[start : start + size, start : start + size] = next(cone)[:size, :size]
    contact = types.SimpleNamespace(dim=np.array(sizes), efc_address=addresses)
    return jacobian, contact, cones, np.asarray(jacobian).T @ matrix @ np.asarray(jacobian)


@pytest.mark.parametrize("sizes", [[3, 3], [4, 1, 4, 3], [6], [1]])
def test_the_sum_over_contacts_is_the_product_with_the_matrix_of_all_rows(sizes):
    jacobian, contact, cones, expected = cone_rows(sizes, jax.random.key(3))
    np.testing.assert_allclose(mjx_compat._cone_hessian(jacobian, contact, cones), expected, atol=1e-4)


def test_mjx_without_the_function_of_its_solver_is_an_error_that_names_the_version(monkeypatch):
    import_module = importlib.import_module
    modules = {"mujoco.mjx._src.solver": types.SimpleNamespace()}
    monkeypatch.setattr(importlib, "import_module", lambda name, *rest: modules.get(name) or import_module(name, *rest))
    with pytest.raises(ImportError, match=r"has no solver\._update_gradient"):
        mjx_compat.sum_cones_by_contact()
