"""Settings by name: lengths and options of a learner that go together, for the shell, sweep files and Python.

Importing this module loads neither NumPy nor jax.
"""

from typing import Any, NamedTuple

from earl_jax import assets
from earl_jax.errors import InputError

LENGTHS = {"seeds": 5, "steps": 100_000, "eval_every": 10_000, "eval_episodes": 10, "checkpoint_every": 100_000}
"""The defaults of `train`, of the command line and of sweep files."""
ALGO = "fbrl"
"""The method that `train` takes by default."""


class Preset(NamedTuple):
    """What a name stands for: `lengths` and `options` that differ from the defaults.

    Where `lengths` has no steps, they are those of the paper for the task.
    """

    summary: str
    lengths: dict[str, int]
    options: dict[str, Any]


PRESETS = {
    "paper": Preset(
        "The paper's run: published number of steps, five seeds, and the learner's defaults, which are the paper's.",
        {},
        {},
    ),
    "quick": Preset(
        "Minutes on a CPU: the small learner of the quickstart, which was tuned for FBRL on tabletop_organization.",
        {"seeds": 2, "steps": 170_000, "eval_every": 2500, "eval_episodes": 50},
        {
            "hidden_sizes": (64, 64),
            "batch_size": 64,
            "learning_rate": 1e-3,
            "timeout_bootstrap": True,
            "demo_share": 0.5,
            "layer_norm": True,
        },
    ),
    "strong": Preset(
        "The paper's lengths and networks with layer norm in the critics, which kept them from diverging on sawyer_peg, and "
        "bootstrapping through time-outs, without which cheetah_run lost up to half of its return. Not tested on other tasks.",
        {},
        {"layer_norm": True, "timeout_bootstrap": True},
    ),
}


def preset(name: str, env: str | None = None, **changes: Any) -> dict[str, Any]:
    """Return the keyword arguments of `train` that the preset `name` stands for on the task `env`, with `changes`.

    Seeds and lengths are always among them, the steps as far as the preset or the paper has some for the task.

    Raises:
        ValueError: there is no such preset, or the paper has no number of steps for the task and `changes` has none.
    """
    if name not in PRESETS:
        raise InputError(f"unknown preset {name!r}; choose from {', '.join(PRESETS)}")
    lengths = {**{key: value for key, value in LENGTHS.items() if key != "steps"}, **PRESETS[name].lengths}
    values = {**lengths, **PRESETS[name].options, **changes}
    if "steps" not in values and env is not None:
        values["steps"] = _published_steps(name, env)
    return values


def _published_steps(name: str, env: str) -> int:
    row = assets.published_row("steps", env=env)
    if not row:
        known = ", ".join(row["env"] for row in assets.published("steps"))
        raise InputError(
            f"the preset {name} takes the published number of steps, and {env!r} has none; give the steps, or choose from {known}"
        )
    return int(row["low"])
