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
def replace_module(monkeypatch):
    """Return a function that replaces one of MJX's modules by another one."""
    import_module, modules = importlib.import_module, {}
    monkeypatch.setattr(importlib, "import_module", lambda name, *rest: modules.get(name) or import_module(name, *rest))
    return lambda name, module: modules.update({f"mujoco.mjx._src.{name}": module})


@pytest.fixture
def fake_scan(replace_module):
    """A module with a `body_tree` of its own, in place of MJX's `scan`."""
    scan = types.SimpleNamespace(body_tree=lambda model, f, *args: f(*args))
    replace_module("scan", scan)
    return scan


@pytest.fixture
def affected(monkeypatch):
    """A release of jaxlib with the slow fusion, on a CPU."""
    monkeypatch.setattr(mjx_compat, "_jaxlib_version", lambda: mjx_compat.AFFECTED_JAXLIB)


needs_guard = pytest.mark.skipif(not mjx_compat.needs_guard(), reason="XLA compiles MJX's kinematics fast here")


@needs_guard
def test_a_step_on_mjx_puts_the_barrier_into_body_tree_once():
    env = make("minitaur_pen", engine="mjx")
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


@pytest.mark.parametrize(
    ("version", "backend"),
    [((0, 9), "cpu"), (mjx_compat.FIXED_JAXLIB, "cpu"), (mjx_compat.AFFECTED_JAXLIB, "gpu")],
)
def test_a_jaxlib_without_the_slow_fusion_and_an_accelerator_are_left_alone(fake_scan, monkeypatch, version, backend):
    monkeypatch.setattr(mjx_compat, "_jaxlib_version", lambda: version)
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    assert not mjx_compat.guard_kinematics()
    assert not mjx_compat.is_guarded(fake_scan)


def cone_rows(sizes):
    """Return the constraint rows, the contacts and the cones of contacts with `sizes` rows, and the sum as MJX forms it."""
    first, total, rng = 3, 3 + sum(sizes) + 1, np.random.default_rng(3)
    addresses = first + np.cumsum([0, *sizes[:-1]])
    jacobian = rng.normal(size=(total, 4)).astype(np.float32)
    cones = rng.normal(size=(sum(size > 1 for size in sizes), 6, 6)).astype(np.float32)
    matrix, cone = np.zeros((total, total)), iter(cones)
    for size, start in zip(sizes, addresses, strict=True):
        if size > 1:
            matrix[start : start + size, start : start + size] = next(cone)[:size, :size]
    contact = types.SimpleNamespace(dim=np.array(sizes), efc_address=addresses)
    return jacobian, contact, cones, jacobian.T @ matrix @ jacobian


@pytest.mark.parametrize("sizes", [[3, 3], [4, 1, 4, 3], [6], [1]])
def test_the_sum_over_contacts_is_the_product_with_the_matrix_of_all_rows(sizes):
    jacobian, contact, cones, expected = cone_rows(sizes)
    hessian = jax.jit(lambda *arrays: mjx_compat._cone_hessian(arrays[0], contact, arrays[1]))(jacobian, cones)
    np.testing.assert_allclose(hessian, expected, atol=1e-4)


def test_mjx_without_the_function_of_its_solver_is_an_error_that_names_the_version(replace_module):
    replace_module("solver", types.SimpleNamespace())
    with pytest.raises(ImportError, match=r"has no solver\._update_gradient"):
        mjx_compat.sum_cones_by_contact()
