"""Tests of the public names: light imports, documentation, entry points."""

import subprocess
import sys

import pytest

import earl_jax
from earl_jax.envs.tabletop import TabletopOrganization

HEAVY = ("brax", "gymnasium", "matplotlib", "mujoco", "orbax", "flax", "jax")


def test_import_loads_no_simulator_plotting_or_learner():
    code = f"import sys, earl_jax; print([name for name in {HEAVY} if name in sys.modules])"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.strip() == "[]"


def test_making_a_task_loads_no_learner_or_simulator():
    code = (
        "import sys, earl_jax; earl_jax.make('tabletop_organization');"
        "print([name for name in ('brax', 'mujoco', 'gymnasium', 'matplotlib') if name in sys.modules])"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.strip() == "[]"


def test_the_public_names_are_these():
    assert earl_jax.__all__ == [
        *["Continuing", "Deployment", "Env", "HelpBudget", "InputError", "Method", "MujocoEnv", "Policy", "Problem"],
        *["Protocol", "Result", "State", "evaluate", "lifetime", "list_algos", "list_envs", "list_pretrained", "make"],
        *["make_algo", "method_for", "preset", "pretrained", "pretrained_info", "register_algo", "register_env"],
        *["resume", "select_seed", "train"],
    ]


def test_every_public_name_is_documented():
    for name in earl_jax.__all__:
        assert getattr(earl_jax, name).__doc__, name
        assert name in dir(earl_jax)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = earl_jax.nonsense


class ExternalTask(TabletopOrganization):
    """A task of another package."""

    name = "external"


def test_env_of_another_package_is_listed_and_built(monkeypatch):
    from importlib import metadata

    from earl_jax.envs import list_envs, make

    before = list_envs()
    point = metadata.EntryPoint("external", "tests.test_package:ExternalTask", "earl_jax.envs")
    real = metadata.entry_points
    monkeypatch.setattr(
        metadata, "entry_points", lambda **kind: [point] if kind == {"group": "earl_jax.envs"} else real(**kind)
    )
    assert set(list_envs()) == {*before, "external"}
    assert make("external", wide=True).wide
