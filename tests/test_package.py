"""The public face: light to import, complete to list."""

import subprocess
import sys

import pytest

import earl_jax
from earl_jax.envs.tabletop import TabletopOrganization

HEAVY = ("brax", "gymnasium", "matplotlib", "mujoco", "orbax", "flax", "jax")


def test_importing_loads_no_simulator_no_plotting_no_learner():
    code = f"import sys, earl_jax; print([name for name in {HEAVY} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_making_a_task_needs_no_learner_and_no_xml():
    code = (
        "import sys, earl_jax; earl_jax.make('tabletop_organization');"
        "print([name for name in ('brax', 'mujoco', 'gymnasium', 'matplotlib') if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_every_public_name_is_there_and_documented():
    for name in earl_jax.__all__:
        assert getattr(earl_jax, name).__doc__, name
        assert name in dir(earl_jax)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = earl_jax.nonsense


class Theirs(TabletopOrganization):
    """A task of another package."""

    name = "theirs"


def test_an_env_of_another_package_is_found(monkeypatch):
    from importlib import metadata

    from earl_jax.envs import list_envs, make

    before = list_envs()
    point = metadata.EntryPoint("theirs", "tests.test_package:Theirs", "earl_jax.envs")
    real = metadata.entry_points
    monkeypatch.setattr(
        metadata, "entry_points", lambda **kind: [point] if kind == {"group": "earl_jax.envs"} else real(**kind)
    )
    assert set(list_envs()) == {*before, "theirs"}
    assert make("theirs", wide=True).wide
