"""Train a fixed set of short runs, so that two versions of the code can be compared byte for byte by their metrics.csv.

    python -m benchmarks.fixed_runs OUT [--against OTHER] [--only NAME ...]

Each run becomes the folder OUT/NAME. With --against, the command compares every metrics.csv with that of OTHER, which another
commit wrote on the same machine, and ends with 1 if one differs. Programs of another CPU or of another jax round differently.
"""

import sys
from pathlib import Path
from typing import Any, Literal

import tyro
from tyro.conf import Positional

import earl_jax

SMALL = {"hidden_sizes": [32], "batch_size": 32, "random_steps": 50, "seeds": 2, "eval_episodes": 2}
TABLETOP = "tabletop_organization"
METHODS = ("naive", "fbrl", "r3l", "vaprl", "oracle", "bc", "cfbrl", "medal", "risc", "rlpd")
LENGTH = {"steps": 600, "eval_every": 200}
SHORT = {"steps": 120, "eval_every": 60}
BUDGET = earl_jax.Continuing(budget=3.0)
RUNS: dict[str, tuple[str, str, dict[str, Any]]] = {
    **{f"{TABLETOP}_{method}": (TABLETOP, method, LENGTH) for method in METHODS},
    f"{TABLETOP}_budget": (TABLETOP, "fbrl", {**LENGTH, "setting": BUDGET}),
    f"{TABLETOP}_floats": (TABLETOP, "fbrl", {**LENGTH, "seeds": 4, "reward_scale": [1.0, 1.0, 10.0, 10.0]}),
    f"{TABLETOP}_rates": (TABLETOP, "naive", {**LENGTH, "learning_rate": [1e-3, 3e-4]}),
    "sawyer_door_c": ("sawyer_door", "fbrl", {**LENGTH, "engine": "c"}),
    "minitaur_pen": ("minitaur_pen", "oracle", {**SHORT, "engine": "c"}),
    "franka_kitchen": ("franka_kitchen", "fbrl", {**SHORT, "engine": "c"}),
    "dhand_lightbulb": ("dhand_lightbulb", "naive", {**SHORT, "engine": "c"}),
    "sawyer_door_mjx": ("sawyer_door", "fbrl", {"steps": 60, "eval_every": 60, "eval_episodes": 1, "engine": "mjx"}),
}
Name = Literal[tuple(RUNS)]


def main(out: Positional[Path], against: Path | None = None, only: tuple[Name, ...] = tuple(RUNS)) -> None:
    """Train the runs in place of those of an earlier call, and compare them with those of the folder `against` if asked."""
    differing = []
    for name in only:
        env, algo, options = RUNS[name]
        path = out / name
        earl_jax.train(env, algo, out=path, overwrite=True, **{**SMALL, **options})
        if against is None:
            print(f"{name}: trained", flush=True)
            continue
        same = (path / "metrics.csv").read_bytes() == (against / name / "metrics.csv").read_bytes()
        differing += [] if same else [name]
        print(f"{name}: {'identical' if same else 'DIFFERS'}", flush=True)
    sys.exit(f"{len(differing)} of {len(only)} runs differ: {', '.join(differing)}" if differing else 0)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
