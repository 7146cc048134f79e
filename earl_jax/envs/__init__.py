"""Tasks. To add one, add a file and a line to the table of `options.registry`; other packages use `register_env`."""

from typing import Any

from earl_jax.envs.base import Env as Env, KinematicEnv as KinematicEnv
from earl_jax.envs.demonstrations import DemoScript as DemoScript, DemoStart as DemoStart, TaskDemos as TaskDemos
from earl_jax.envs.engines import (
    chosen_engine as chosen_engine,
    for_lanes as for_lanes,
    with_engine as with_engine,
)
from earl_jax.envs.features import ContinuingDefaults as ContinuingDefaults, Map as Map, Starts as Starts, View as View
from earl_jax.envs.help_budget import HelpBudget as HelpBudget, without_budget as without_budget
from earl_jax.envs.mujoco_env import MujocoEnv as MujocoEnv
from earl_jax.envs.starts import balanced_starts as balanced_starts, start_of as start_of
from earl_jax.envs.state import State as State
from earl_jax.options.registry import ENVS

PAPER_TASKS = (
    "tabletop_organization",
    "sawyer_door",
    "sawyer_peg",
    "franka_kitchen",
    "dhand_lightbulb",
    "minitaur_pen",
)
"""The six tasks of the paper, in its order."""

list_envs = ENVS.names
"""`list_envs()` returns the names that `make` accepts, sorted."""
register_env = ENVS.register
"""`register_env(name, cls)` registers the `Env` subclass `cls` for `make`. A name that is taken raises a ValueError."""
env_class = ENVS.get


def make(name: str, /, **options: Any) -> Env:
    """Return the task `name` with these options, for example `make("tabletop_organization", wide=True)`.

    Raises:
        ValueError: the name or an option is unknown, or a value has the wrong type; the message lists the choices.
    """
    return ENVS.make(name, **options)
