"""Presets: seeds, a schedule and learner options that belong together, for the shell, sweep files and Python.

Importing this module loads neither NumPy nor jax.
"""

import dataclasses
from typing import Any

from earl_jax import assets
from earl_jax.errors import InputError, require_known
from earl_jax.options.schedule import Schedule
from earl_jax.options.seeds import SEEDS

ALGO = "fbrl"
"""The method that `train` uses by default."""


@dataclasses.dataclass(frozen=True)
class Preset:
    """What a preset stands for: seeds, a schedule and `options` that differ from the defaults.

    With `published_steps`, a run has the paper's number of steps for the task.
    """

    summary: str = ""
    options: dict[str, Any] = dataclasses.field(default_factory=dict)
    seeds: int = SEEDS
    schedule: Schedule = dataclasses.field(default=Schedule())
    published_steps: bool = False


PRESETS = {
    "paper": Preset(
        "The paper's run: published number of steps, five seeds, and the learner's defaults.",
        published_steps=True,
    ),
    "quick": Preset(
        "Minutes on a CPU: the small learner of the quickstart, which was tuned for FBRL on tabletop_organization.",
        {
            "hidden_sizes": (64, 64),
            "batch_size": 64,
            "learning_rate": 1e-3,
            "timeout_bootstrap": True,
            "demo_share": 0.5,
            "layer_norm": True,
        },
        seeds=2,
        schedule=Schedule(steps=170_000, eval_every=2500, eval_episodes=50),
    ),
    "strong": Preset(
        "The paper's steps and networks with layer norm in the critics, which kept them from diverging on sawyer_peg, and "
        "bootstrapping through time-outs, without which cheetah_run lost up to half of its return, and the oracle and R3L "
        "returned less on minitaur_pen. Not tested on other tasks.",
        {"layer_norm": True, "timeout_bootstrap": True},
        published_steps=True,
    ),
}


def preset(name: str, env: str | None = None, **changes: Any) -> dict[str, Any]:
    """Return the keyword arguments of `train` that the preset `name` stands for on the task `env`, with `changes`.

    The result includes the seeds and the schedule. A preset of the published length needs `env`, or `steps`.

    Raises:
        ValueError: there is no such preset, or its number of steps is unknown.
    """
    chosen = named_preset(name, env, changes.get("steps"))
    return {"seeds": chosen.seeds, **dataclasses.asdict(chosen.schedule), **chosen.options, **changes}


def named_preset(name: str, env: str | None, steps: int | None) -> Preset:
    """Return the preset `name` with its steps on the task `env`, or with `steps` if given. Errors as `preset`."""
    require_known("preset", name, PRESETS)
    chosen = PRESETS[name]
    if chosen.published_steps and steps is None:
        if env is None:
            raise InputError(f"the preset {name} uses the published number of steps of a task: preset({name!r}, TASK)")
        row = assets.published_row("steps", env=env)
        if not row:
            known = ", ".join(row["env"] for row in assets.published("steps"))
            problem = f"the preset {name} takes the published number of steps, and {env!r} has none"
            raise InputError(f"{problem}; give the steps, or choose from {known}")
        steps = int(row["low"])
    return dataclasses.replace(chosen, schedule=chosen.schedule.changed(steps=steps))
