"""The names of all tasks, methods, learners and presets, and the stored descriptions of the package's own classes.

Importing the classes loads jax, which takes about two seconds. `make catalog` therefore stores their descriptions in
catalog.json, and a test compares the two.
"""

import functools
import json
from pathlib import Path
from typing import Any

from earl_jax import algos, envs
from earl_jax.algos import learner
from earl_jax.options.presets import PRESETS

CATALOG = Path(__file__).with_name("catalog.json")
LOCATE = {"task": envs.locate_env, "method": algos.locate_algo, "learner": learner.locate_learner}
TASK_NUMBERS = ("observation_size", "goal_size", "action_size", "reward_type", "train_horizon", "eval_horizon")
"""The attributes of a task that its description has."""


def names() -> dict[str, list[str]]:
    """Return the names of all tasks, methods, learners and presets, by kind."""
    known = {"task": envs.list_envs(), "method": algos.list_algos(), "learner": learner.list_learners()}
    return {**known, "preset": list(PRESETS)}


@functools.cache
def stored() -> dict[str, Any]:
    """Return the stored descriptions by class, and under `shared` the options of every learner."""
    return json.loads(CATALOG.read_text())
