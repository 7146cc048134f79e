"""Every table and figure of the paper by name: the runs that it takes at a scale, and the report that it ends in.

Runs of one folder are shared: both tables, the curves, figures 4 and 5 read the same ones. A grid is written beside them, so that
`earl-jax sweep` says the same.
"""

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from earl_jax import assets, envs
from earl_jax.paper.curves import write_curves
from earl_jax.paper.figure2 import HORIZONS, write_figure2
from earl_jax.paper.figure4 import Map, write_figure4
from earl_jax.paper.figure5 import write_figure5
from earl_jax.paper.tables import write_table
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import grid
from earl_jax.sweeps.launcher import sweep
from earl_jax.training import evaluate, load_lanes

TASKS = ("tabletop_organization", "sawyer_door", "sawyer_peg", "franka_kitchen", "dhand_lightbulb", "minitaur_pen")
METHODS = ("naive", "fbrl", "r3l", "vaprl", "oracle")
FIGURE2_STEPS = 1_000_000
"""Training steps of figure 2, which the paper does not print: five lives between resets at the longest horizon."""
ROBUSTNESS_EPISODES = 100
Options = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Scale:
    """How much of an experiment is run: `share` of its published steps, or `steps`, of `seeds` lives, with `options` for all."""

    seeds: int
    share: float = 1.0
    steps: int | None = None
    eval_every: int = 10_000
    eval_episodes: int = 10
    tasks: int | None = None
    """How many of an experiment's tasks, the first ones; None for all."""
    options: Options = dataclasses.field(default_factory=dict)

    def length(self, published: int, every: int) -> int:
        """Return the steps of a run that was `published` with so many, a multiple of `every`."""
        wanted = self.steps or round(self.share * published)
        return max(1, wanted // every) * every


SMALL = {"hidden_sizes": [16, 16], "batch_size": 16, "random_steps": 100}
SCALES = {
    "smoke": Scale(seeds=2, steps=200, eval_every=100, eval_episodes=2, tasks=1, options=SMALL),
    "short": Scale(seeds=3, share=0.1),
    "full": Scale(seeds=5),
}


@dataclasses.dataclass(frozen=True)
class Block:
    """Runs that differ in their task and method alone, or in `options` that hold lists of alternatives."""

    env: str
    algos: tuple[str, ...]
    steps: int
    options: Options = dataclasses.field(default_factory=dict)
    sparser: int = 1
    """How many times rarer than the scale says it is evaluated, where an evaluation takes long."""


@dataclasses.dataclass(frozen=True)
class Exhibit:
    """One table or figure: the tasks it can show, the runs that each takes, and the report that is made of their folders."""

    tasks: tuple[str, ...]
    block: Callable[[str], Block]
    report: Callable[[Sequence[Path], Path], list[Path]]


def _paper_block(algos: tuple[str, ...]) -> Callable[[str], Block]:
    def block(env: str) -> Block:
        able = envs.make(env).has_demos
        steps = int(assets.published_row("steps", env=env)["low"])
        return Block(env, tuple(algo for algo in algos if able or algo != "vaprl"), steps)

    return block


def _horizons(env: str) -> Block:
    alternatives = {"train_horizon": list(HORIZONS), "timeout_bootstrap": [False, True]}
    return Block(env, ("naive",), FIGURE2_STEPS, alternatives, sparser=2)


def _maps(folders: Sequence[Path], out: Path) -> list[Path]:
    """Draw figure 4 from the maps of visited places that the lanes of `folders` have kept."""
    maps = []
    for folder in map(RunFolder.open, folders):
        env, _, lanes = load_lanes(folder)
        if lanes.visits is not None and env.map_bounds is not None:
            one = folder.config
            visits = np.asarray(lanes.visits)
            maps.append(Map(one.env, one.algo, visits, env.map_bounds, int(visits[0].sum())))
    return write_figure4(maps, out)


def _robustness(folders: Sequence[Path], out: Path) -> list[Path]:
    """Draw figure 5: the final policies of `folders` from the published start and from starts all over the table."""
    rows = []
    for folder in folders:
        initial, uniform = (
            evaluate(folder, ROBUSTNESS_EPISODES, starts=starts)["deployed/success"]
            for starts in ("initial", "uniform")
        )
        one = RunFolder.open(folder).config
        for seed, *success in zip(one.seeds, initial.tolist(), uniform.tolist(), strict=True):
            rows.append({"algo": one.algo, "seed": seed, "success_initial": success[0], "success_uniform": success[1]})
    return write_figure5(rows, out)


EXPERIMENTS = {
    "table1": Exhibit(TASKS, _paper_block(METHODS), lambda folders, out: write_table(1, folders, out)),
    "table2": Exhibit(TASKS, _paper_block(METHODS), lambda folders, out: write_table(2, folders, out)),
    "curves": Exhibit(TASKS, _paper_block(METHODS), write_curves),
    "figure2": Exhibit(("cheetah_run", "fish_swim"), _horizons, write_figure2),
    "figure4": Exhibit(
        ("tabletop_organization", "sawyer_peg", "minitaur_pen"), _paper_block(("fbrl", "oracle")), _maps
    ),
    "figure5": Exhibit(("tabletop_organization",), _paper_block(("fbrl", "vaprl", "oracle")), _robustness),
}


def reproduce(
    name: str,
    scale: str = "smoke",
    out: Path | None = None,
    tasks: Sequence[str] = (),
    seeds: int | None = None,
    steps: int | None = None,
    options: Options | None = None,
    max_lanes: int | None = None,
    devices: int | None = None,
    say: Callable[[str], None] = print,
) -> list[Path]:
    """Return the files of table or figure `name` at `scale`, after training what is not finished yet.

    Args:
        name: one of `EXPERIMENTS`.
        scale: one of `SCALES`: the path end to end in a minute, a tenth of the paper, or the paper.
        out: one folder for runs and results; the same call goes on with what is there.
        tasks: only these of the experiment's tasks.
        seeds: another number of seeds than the scale's.
        steps: another length than the scale's.
        options: of tasks or methods, for every run; a list holds alternatives.
        max_lanes: lanes of the largest program.
        devices: how many devices share the lanes of a program.
        say: told a line for each run.

    Raises:
        ValueError: a name, task or option is unknown, or the folder holds other runs; the message says which.
    """
    experiment, chosen = _known("experiment", EXPERIMENTS, name), _known("scale", SCALES, scale)
    chosen = dataclasses.replace(chosen, seeds=seeds or chosen.seeds, steps=steps or chosen.steps)
    for task in tasks:
        if task not in experiment.tasks:
            raise ValueError(f"{name} shows nothing of {task!r}; choose from {', '.join(experiment.tasks)}")
    out = out or Path("runs") / f"reproduce-{scale}"
    blocks = [experiment.block(task) for task in tasks or experiment.tasks[: chosen.tasks]]
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"{name}.toml"
    file.write_text(toml(blocks, chosen, options or {}))
    sweep(file, out / "runs", max_lanes=max_lanes, devices=devices, say=say)
    folders = [out / "runs" / cell.name for cell in grid.read(file)]
    folders = [path for path in folders if (path / "metrics.csv").is_file()]
    if not folders:
        raise ValueError(f"no run of {name} has come to an evaluation; the lines above say why")
    return experiment.report(folders, out / name)


def _known(kind: str, table: dict[str, Any], name: str) -> Any:
    if name not in table:
        raise ValueError(f"unknown {kind} {name!r}; choose from {', '.join(table)}")
    return table[name]


def toml(blocks: Sequence[Block], scale: Scale, options: Options) -> str:
    """Return the grid of `blocks` at `scale` as `earl-jax sweep` reads it."""
    parts = []
    for block in blocks:
        every = scale.eval_every * block.sparser
        steps = scale.length(block.steps, every)
        lengths = {"steps": steps, "eval_every": every, "eval_episodes": scale.eval_episodes}
        table = {"envs": [block.env], "algos": list(block.algos), "seeds": scale.seeds, **lengths}
        table["checkpoint_every"] = max(steps // 5, every)
        chosen = {**scale.options, **block.options, **options}
        sizes = chosen.get("hidden_sizes")
        if sizes and not isinstance(sizes[0], list):
            chosen["hidden_sizes"] = [sizes]
        parts += ["[[runs]]", *_lines(table), "[runs.options]", *_lines(chosen), ""]
    return "\n".join(parts)


def _lines(table: dict[str, Any]) -> list[str]:
    return [f"{key} = {json.dumps(value)}" for key, value in table.items()]
