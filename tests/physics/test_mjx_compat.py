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
    env = make("fish_swim", physics="mjx")
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


def test_the_version_of_jaxlib_is_compared_as_numbers(monkeypatch):
    monkeypatch.setattr(metadata, "version", lambda package: {"jaxlib": "0.10.2"}[package])
    assert mjx_compat._jaxlib_version() == (0, 10)
