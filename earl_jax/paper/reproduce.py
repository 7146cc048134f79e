"""Every table and figure of the paper by name: its runs at a scale, trained, and the files made of them.

In addition there is the trade-off that the paper's conclusion names but does not show. Runs in one folder are shared:
both tables and figures 3, 4 and 5 read the same runs. The grid of the runs is written beside them, so that `earl-jax
sweep` can train the same runs.
"""

import dataclasses
import json
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

from earl_jax.errors import InputError, require_known
from earl_jax.options import imports
from earl_jax.options.schedule import Schedule
from earl_jax.options.seeds import seed_list
from earl_jax.options.values import COUNT, TimeLimit, require
from earl_jax.paper.artefact import Artefact, Block, Options
from earl_jax.paper.figure2 import FIGURE2
from earl_jax.paper.figure3 import FIGURE3
from earl_jax.paper.figure4 import FIGURE4
from earl_jax.paper.figure5 import FIGURE5
from earl_jax.paper.score_tables import TABLE1, TABLE2
from earl_jax.paper.tradeoff import TRADEOFF
from earl_jax.report.style import matplotlib
from earl_jax.runs.files import check_folder, write_atomically
from earl_jax.sweeps import grid
from earl_jax.sweeps.launcher import sweep
from earl_jax.sweeps.slots import PerDevice

ARTEFACTS = {made.name: made for made in (TABLE1, TABLE2, FIGURE2, FIGURE3, FIGURE4, FIGURE5, TRADEOFF)}


@dataclasses.dataclass(frozen=True)
class Scale:
    """The size of the runs of a result: `share` of its published steps, or `steps`, for `seeds` seeds, all with `options`."""

    seeds: int
    share: float = 1.0
    steps: int | None = None
    eval_every: int = Schedule.eval_every
    eval_episodes: int = Schedule.eval_episodes
    first: int | None = None
    """Number of a result's tasks, and of blocks of runs on each, to run: the first ones; None for all."""
    options: Options = dataclasses.field(default_factory=dict)


SMALL = {"hidden_sizes": [16], "batch_size": 16, "random_steps": 20}
SCALES = {
    "smoke": Scale(seeds=2, steps=120, eval_every=40, eval_episodes=2, first=1, options=SMALL),
    "short": Scale(seeds=3, share=0.1),
    "full": Scale(seeds=5),
}


def reproduce(
    name: str,
    scale: str = "smoke",
    out: str | Path | None = None,
    tasks: Sequence[str] = (),
    seeds: int | None = None,
    steps: int | None = None,
    options: Options | None = None,
    max_lanes: int | None = None,
    devices: int | None = None,
    per_device: PerDevice = None,
    emit: Callable[[str], None] = print,
    minutes: float | TimeLimit | None = None,
) -> tuple[list[Path], tuple[str, ...]]:
    """Train the unfinished runs of table or figure `name` at `scale`; return its files and the names of failed runs.

    Args:
        name: one of `ARTEFACTS`.
        scale: one of `SCALES`: `smoke`, end to end in a minute; `short`, a tenth of the paper; `full`, the paper.
        out: the folder of runs and results; the same call continues the runs in it.
        tasks: the tasks to include; by default all tasks of the artefact.
        seeds: number of seeds instead of the scale's.
        steps: length of the runs instead of the scale's; the part after the last whole `eval_every` is left out.
        options: options of tasks or methods for every run; a list gives alternatives, which tables and figure 5 show.
        max_lanes: largest number of lanes in a program.
        devices: number of devices that share the lanes of a program.
        per_device: number of programs that train on each GPU at a time, as in `sweep`.
        emit: is called with a line of text for each run.
        minutes: a limit of wall-clock time from this call on, as in `sweep`. If runs are then unfinished, or no run has
            reached an evaluation, nothing is written, `emit` receives their names, and no file is returned.

    Raises:
        ValueError: a name, task or option is unknown, or the folder holds other runs; the message says which.
    """
    limit = TimeLimit.of(minutes)
    matplotlib()  # which the report needs, before any training
    text = grid_text(name, scale, tasks, seeds, steps, options)
    out = Path(out or f"runs/reproduce-{scale}")
    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"{name}.toml"
    earlier = file.read_bytes() if file.is_file() else None
    write_atomically(file, text)
    try:
        outcome = sweep(
            file, out / "runs", max_lanes=max_lanes, devices=devices, per_device=per_device, emit=emit, minutes=limit
        )
    except InputError:  # nothing has started
        if earlier is None:
            file.unlink()
        else:
            write_atomically(file, earlier)
        raise
    if outcome.unfinished:
        emit(f"{name} is not written; unfinished runs: {', '.join(outcome.unfinished)}")
        return [], outcome.failed
    imports.run_noted()
    folders = [out / "runs" / spec.name for spec in grid.read(file)]
    folders = [path for path in folders if (path / "metrics.csv").is_file()]
    if not folders:
        emit(f"{name} is not written; no run of it has reached an evaluation")
        return [], outcome.failed
    return ARTEFACTS[name].write(folders, out / name), outcome.failed


def grid_text(
    name: str,
    scale: str,
    tasks: Sequence[str] = (),
    seeds: int | None = None,
    steps: int | None = None,
    options: Options | None = None,
) -> str:
    """Return the runs of an artefact as a grid in TOML, which `earl-jax sweep` reads. Arguments and errors as `reproduce`."""
    require_known("experiment", name, ARTEFACTS)
    require_known("scale", scale, SCALES)
    made, chosen = ARTEFACTS[name], SCALES[scale]
    if seeds is not None:
        seed_list(seeds)
    if steps is not None:
        require("steps", steps, COUNT)
    for task in tasks:
        if task not in made.tasks:
            raise InputError(f"{name} has no task {task!r}; choose from {', '.join(made.tasks)}")
    chosen = dataclasses.replace(chosen, seeds=seeds or chosen.seeds, steps=steps or chosen.steps)
    blocks = [block for task in tasks or made.tasks[: chosen.first] for block in made.blocks(task)[: chosen.first]]
    return "\n".join(line for block in blocks for line in _block_lines(made, block, chosen, options or {}))


def _block_lines(made: Artefact, block: Block, scale: Scale, options: Options) -> list[str]:
    length = scale.steps or round(scale.share * block.steps)
    eval_every = min(scale.eval_every * block.eval_every_factor, length)
    steps = length // eval_every * eval_every
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
    if sizes and isinstance(sizes, list | tuple) and not isinstance(sizes[0], list):
        merged["hidden_sizes"] = [sizes]
    for option in options if not made.variants else ():
        if option not in block.options and isinstance(merged[option], list | tuple) and len(merged[option]) > 1:
            raise InputError(f"{made.name} cannot have runs that differ in {option}; give it one value")
    return ["[[runs]]", *_toml_lines(run), "[runs.options]", *_toml_lines(merged), ""]


def _toml_lines(table: Options) -> list[str]:
    """Return the options of `table` in TOML; a ValueError names one that a grid cannot hold, such as infinity."""
    values = {key: grid.NULL if value is None else value for key, value in table.items()}
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in values.items()]
    for line in lines:
        try:
            tomllib.loads(line)
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"option {line}: the grid of the runs is TOML, which has no such name or value") from error
    return lines
