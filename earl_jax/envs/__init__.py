"""The registry of tasks. To add a task, add a file and a line to the table below; other packages use `register_env`.

The classes are loaded on first use, so that the names can be listed without jax.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from earl_jax.options import lazy
from earl_jax.options.registry import Registry

if TYPE_CHECKING:
    from earl_jax.envs.base import Env, KinematicEnv
    from earl_jax.envs.demonstrations import DemoScript, DemoStart, TaskDemos
    from earl_jax.envs.engines import chosen_engine, for_lanes, resolved_engine, with_engine
    from earl_jax.envs.features import ContinuingDefaults, Map, Starts, View
    from earl_jax.envs.mujoco_env import MujocoEnv
    from earl_jax.envs.starts import balanced_starts, start_of
    from earl_jax.envs.state import State
    from earl_jax.envs.wrappers.help_budget import HelpBudget, without_budget

__all__ = [
    "PAPER_TASKS",
    "ContinuingDefaults",
    "DemoScript",
    "DemoStart",
    "Env",
    "HelpBudget",
    "KinematicEnv",
    "Map",
    "MujocoEnv",
    "Starts",
    "State",
    "TaskDemos",
    "View",
    "balanced_starts",
    "chosen_engine",
    "env_class",
    "for_lanes",
    "list_envs",
    "locate_env",
    "make",
    "register_env",
    "resolved_engine",
    "start_of",
    "with_engine",
    "without_budget",
]

__getattr__ = lazy.attributes(
    __name__,
    {
        "base": "Env KinematicEnv",
        "demonstrations": "DemoScript DemoStart TaskDemos",
        "engines": "chosen_engine for_lanes resolved_engine with_engine",
        "features": "ContinuingDefaults Map Starts View",
        "mujoco_env": "MujocoEnv",
        "starts": "balanced_starts start_of",
        "state": "State",
        "wrappers.help_budget": "HelpBudget without_budget",
    },
)
PAPER_TASKS = (
    "tabletop_organization",
    "sawyer_door",
    "sawyer_peg",
    "franka_kitchen",
    "dhand_lightbulb",
    "minitaur_pen",
)
"""The six tasks of the paper, in its order."""

_ENVS: Registry[Env] = Registry(
    "env",
    "earl_jax.envs.base:Env",
    {
        "cheetah_run": "earl_jax.envs.dm_control.cheetah_run:CheetahRun",
        "dhand_lightbulb": "earl_jax.envs.dhand.lightbulb:DHandLightbulb",
        "fish_swim": "earl_jax.envs.dm_control.fish_swim:FishSwim",
        "franka_kitchen": "earl_jax.envs.kitchen.franka_kitchen:FrankaKitchen",
        "minitaur_pen": "earl_jax.envs.minitaur.pen:MinitaurPen",
        "sawyer_door": "earl_jax.envs.sawyer.door:SawyerDoor",
        "sawyer_peg": "earl_jax.envs.sawyer.peg:SawyerPeg",
        "tabletop_organization": "earl_jax.envs.tabletop:TabletopOrganization",
    },
)
list_envs = _ENVS.names
"""`list_envs()` returns the names that `make` takes, sorted."""
register_env = _ENVS.register
"""`register_env(name, cls)` registers the `Env` subclass `cls` for `make`. A name that is taken is a ValueError."""
locate_env = _ENVS.locate
env_class = _ENVS.get
make = _ENVS.make
"""`make(name, **options)` returns the task `name` with these options, e.g. `make("tabletop_organization", wide=True)`.

An unknown name or option, or a value of another type, is a ValueError that lists the choices."""
