"""Every table and figure of the paper by name: the runs that it takes at a scale, and the report made of them.

The trade-off of the conclusion is one more, which the paper names and does not show. Runs of one folder are shared:
both tables, the curves, and figures 4 and 5 read the same ones. The grid of the runs is written beside them, so that
`earl-jax sweep` can train the same ones.
"""

import dataclasses
import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from earl_jax.envs import PAPER_TASKS, make
from earl_jax.errors import InputError
from earl_jax.options import COUNT, TimeLimit, require
from earl_jax.paper import tasks as paper_tasks
from earl_jax.paper.curves import write_curves
from earl_jax.paper.figure2 import write_figure2
from earl_jax.paper.figure4 import write_figure4
from earl_jax.paper.figure5 import write_figure5
from earl_jax.paper.score_tables import write_table
from earl_jax.paper.tradeoff import write_tradeoff
from earl_jax.paper.visit_maps import visit_map
from earl_jax.runs.files import write_atomically
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import grid
from earl_jax.sweeps.launcher import sweep
from earl_jax.sweeps.slots import PerDevice
from earl_jax.training import evaluate, load_visits

ROBUSTNESS_EPISODES = 100
Options = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Scale:
    """The size of the runs of a result: `share` of its published steps, or `steps`, for `seeds` seeds.

    `options` hold for all of them.
    """

    seeds: int
    share: float = 1.0
    steps: int | None = None
    eval_every: int = 10_000
    eval_episodes: int = 10
    tasks: int | None = None
    """Number of a result's tasks to run, the first ones; None for all."""
    blocks: int | None = None
    """Number of blocks of runs on a task, the first ones; None for all."""
    options: Options = dataclasses.field(default_factory=dict)

    def length(self, published: int, eval_every: int) -> int:
        """Return the steps of a run whose `published` length is given, a multiple of `eval_every`."""
        wanted = self.steps or round(self.share * published)
        return max(1, wanted // eval_every) * eval_every


SMALL = {"hidden_sizes": [16], "batch_size": 16, "random_steps": 20}
SCALES = {
    "smoke": Scale(seeds=2, steps=120, eval_every=40, eval_episodes=2, tasks=1, blocks=1, options=SMALL),
    "short": Scale(seeds=3, share=0.1),
    "full": Scale(seeds=5),
}


@dataclasses.dataclass(frozen=True)
class Block:
    """Runs on one task that differ only in their method, or in `options` that hold lists of alternatives."""

    env: str
    algos: tuple[str, ...]
    steps: int
    options: Options = dataclasses.field(default_factory=dict)
    eval_every_factor: int = 1
    """Factor on the scale's `eval_every`, for tasks whose evaluations take long."""


@dataclasses.dataclass(frozen=True)
class PaperResult:
    """One table or figure: its possible tasks, the runs for each of them, and the report made of the run folders."""

    tasks: tuple[str, ...]
    blocks: Callable[[str], list[Block]]
    report: Callable[[Sequence[Path], Path], list[Path]]


def _table_blocks(methods: tuple[str, ...], env: str) -> list[Block]:
    """Return the runs of `methods` on one of the paper's six tasks, at their published length."""
    return [Block(env, paper_tasks.methods_on(env, methods), paper_tasks.training_steps(env))]


def _horizon_blocks(env: str) -> list[Block]:
    """Return the runs of figure 2 on one task: every horizon with both TD updates.

    A goal stays until the next reset: in the paper's words, the agent has to undo the task before it can practise it
    again. Naive RL in the deployment setting would draw another goal every 1,000 steps.
    """
    updates: Options = {"timeout_bootstrap": [False, True]}
    horizons = list(paper_tasks.FIGURE2_HORIZONS)
    options = [{"train_horizon": horizons}]
    if len(make(env).goal_states) > 1:
        options = [{"train_horizon": h, "setting": "continuing", "goal_change": h} for h in horizons]
    return [
        Block(env, ("naive",), paper_tasks.FIGURE2_STEPS, {**tied, **updates}, eval_every_factor=2) for tied in options
    ]


def _tradeoff_blocks(env: str) -> list[Block]:
    """Return the runs of the trade-off on one task: every epsilon without a budget, and every budget without an epsilon."""
    varied: list[Options] = [{"intervention_chance": list(paper_tasks.TRADEOFF_CHANCES)}]
    varied += [{"budget": budget} for budget in paper_tasks.TRADEOFF_BUDGETS]
    return [
        Block(env, (algo,), paper_tasks.TRADEOFF_STEPS, options)
        for algo in paper_tasks.methods_on(env, paper_tasks.TRADEOFF_METHODS)
        for options in varied
    ]


def _figure4_report(folders: Sequence[Path], out: Path) -> list[Path]:
    """Draw figure 4 from the maps of visited positions of `folders`, which need no checkpoints."""
    maps = []
    for folder in map(RunFolder.open, folders):
        env, visits = load_visits(folder)
        if visits is None or env.map_bounds is None:
            continue
        maps.append(visit_map(env, folder.config.algo, visits))
    return write_figure4(maps, out)


def _figure5_report(folders: Sequence[Path], out: Path) -> list[Path]:
    """Draw figure 5: the final policies of `folders` from the published start and from starts all over the table."""
    rows = []
    for folder in folders:
        config = RunFolder.open(folder).config
        success = {
            starts: evaluate(folder, ROBUSTNESS_EPISODES, starts=starts)["deployed/success"].tolist()
            for starts in ("initial", "uniform")
        }
        for lane, seed in enumerate(config.seeds):
            columns = {f"success_{starts}": values[lane] for starts, values in success.items()}
            rows.append({"algo": config.algo, "seed": seed, **columns})
    return write_figure5(rows, out)


_tables = functools.partial(_table_blocks, paper_tasks.METHODS)
RESULTS = {
    "table1": PaperResult(PAPER_TASKS, _tables, functools.partial(write_table, 1)),
    "table2": PaperResult(PAPER_TASKS, _tables, functools.partial(write_table, 2)),
    "curves": PaperResult(PAPER_TASKS, _tables, write_curves),
    "figure2": PaperResult(paper_tasks.FIGURE2_TASKS, _horizon_blocks, write_figure2),
    "figure4": PaperResult(
        tasks=paper_tasks.FIGURE4_TASKS,
        blocks=functools.partial(_table_blocks, paper_tasks.FIGURE4_METHODS),
        report=_figure4_report,
    ),
    "figure5": PaperResult(
        tasks=paper_tasks.FIGURE5_TASKS,
        blocks=functools.partial(_table_blocks, paper_tasks.FIGURE5_METHODS),
        report=_figure5_report,
    ),
    "tradeoff": PaperResult(paper_tasks.TRADEOFF_TASKS, _tradeoff_blocks, write_tradeoff),
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
    per_device: PerDevice = None,
    emit: Callable[[str], None] = print,
    minutes: float | TimeLimit | None = None,
) -> list[Path]:
    """Return the files of table or figure `name` at `scale`, after training the runs that are not finished yet.

    Args:
        name: one of `RESULTS`.
        scale: one of `SCALES`: `smoke`, end to end in a minute; `short`, a tenth of the paper; `full`, the paper.
        out: the folder of runs and results; the same call goes on with the runs that are there.
        tasks: only these of the result's tasks.
        seeds: number of seeds instead of the scale's.
        steps: length of the runs instead of the scale's.
        options: of tasks or methods, for every run; a list holds alternatives.
        max_lanes: lanes of the largest program.
        devices: number of devices that share the lanes of a program.
        per_device: number of programs that train on each GPU at a time, as `sweep` takes it.
        emit: is called with a line of text for each run.
        minutes: a limit of wall-clock time from this call on, as in `sweep`. If it leaves runs unfinished, nothing is
            written, `emit` receives their names, and no file is returned.

    Raises:
        ValueError: a name, task or option is unknown, or the folder holds other runs; the message says which.
    """
    limit = TimeLimit.of(minutes)
    text = _grid(name, scale, tasks, seeds, steps, options or {})
    out = out or Path("runs") / f"reproduce-{scale}"
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"{name}.toml"
    write_atomically(file, text)
    outcome = sweep(
        file, out / "runs", max_lanes=max_lanes, devices=devices, per_device=per_device, emit=emit, minutes=limit
    )
    if outcome.unfinished:
        emit(f"{name} is not written; unfinished runs: {', '.join(outcome.unfinished)}")
        return []
    folders = [out / "runs" / spec.name for spec in grid.read(file)]
    folders = [path for path in folders if (path / "metrics.csv").is_file()]
    if not folders:
        raise InputError(f"no run of {name} has reached an evaluation; the lines above give the causes")
    return RESULTS[name].report(folders, out / name)


def _grid(name: str, scale: str, tasks: Sequence[str], seeds: int | None, steps: int | None, options: Options) -> str:
    """Return the grid of a result, with `tasks`, `seeds` and `steps` in place of those of the scale. Errors as `reproduce`."""
    result, chosen = _lookup("experiment", RESULTS, name), _lookup("scale", SCALES, scale)
    for option, value in (("seeds", seeds), ("steps", steps)):
        if value is not None:
            require(option, value, COUNT)
    for task in tasks:
        if task not in result.tasks:
            raise InputError(f"{name} has no task {task!r}; choose from {', '.join(result.tasks)}")
    chosen = dataclasses.replace(chosen, seeds=seeds or chosen.seeds, steps=steps or chosen.steps)
    blocks = [block for task in tasks or result.tasks[: chosen.tasks] for block in result.blocks(task)[: chosen.blocks]]
    return grid_text(blocks, chosen, options)


def _lookup(kind: str, table: dict[str, Any], name: str) -> Any:
    if name not in table:
        raise InputError(f"unknown {kind} {name!r}; choose from {', '.join(table)}")
    return table[name]


def grid_text(blocks: Sequence[Block], scale: Scale, options: Options) -> str:
    """Return the grid of `blocks` at `scale` as TOML for `earl-jax sweep`."""
    parts = []
    for block in blocks:
        eval_every = scale.eval_every * block.eval_every_factor
        steps = scale.length(block.steps, eval_every)
        run = {
            "envs": [block.env],
            "algos": list(block.algos),
            "seeds": scale.seeds,
            "steps": steps,
            "eval_every": eval_every,
            "eval_episodes": scale.eval_episodes,
            "checkpoint_every": max(steps // 5, eval_every),
        }
        merged = {**scale.options, **block.options, **options}
        sizes = merged.get("hidden_sizes")
        if sizes and not isinstance(sizes[0], list):
            merged["hidden_sizes"] = [sizes]
        parts += ["[[runs]]", *_toml_lines(run), "[runs.options]", *_toml_lines(merged), ""]
    return "\n".join(parts)


def _toml_lines(table: Options) -> list[str]:
    return [f"{key} = {json.dumps(value)}" for key, value in table.items()]
