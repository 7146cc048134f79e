"""The worker of a sweep: cells that fit one program are packed into it, lived together and kept apart.

`python -m earl_jax.packs plan GRID --out DIR` prints the packs as JSON; `python -m earl_jax.packs work` takes cells as a line
of JSON on stdin, prints what becomes of each as lines of JSON, and ends when stdin does: with whoever started it.
"""

import argparse
import contextlib
import dataclasses
import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from earl_jax import grid, memory
from earl_jax.algos import Method, birth, method_for
from earl_jax.algos.life import Loop
from earl_jax.algos.mixed import form
from earl_jax.checkpoint import newest
from earl_jax.envs import Env
from earl_jax.experiment import Experiment, RunFolder
from earl_jax.files import inside
from earl_jax.program import Run, live, per_lane
from earl_jax.training import split_options

SCHEDULER_SIGNALS = (signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2)


@dataclasses.dataclass(frozen=True)
class Entry:
    """A cell ready to be packed: its name in the sweep, what it is, and the step of its newest checkpoint."""

    name: str
    experiment: Experiment
    env: Env
    method: Method
    step: int

    @property
    def lanes(self) -> int:
        """Lives in this cell."""
        return len(self.experiment.seeds)

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.step == self.experiment.steps

    def fit(self) -> Hashable:
        """Return what cells have to agree in to live in one program."""
        one = self.experiment
        lengths = (one.steps, one.eval_every, one.eval_episodes, one.checkpoint_every, self.step)
        world = self.env if self.env.ends else dataclasses.replace(self.env, train_horizon=1)  # lanes carry it as data
        return world, lengths, form(self.method)

    def replay_bytes(self) -> int:
        """Return what the replay of all lanes occupies."""
        loop = Loop(self.env, self.experiment.protocol(self.env))
        return self.lanes * memory.replay_bytes(loop, self.method, self.experiment.steps)


def packed(entries: Sequence[Entry], max_lanes: int | None = None) -> list[list[Entry]]:
    """Return unfinished `entries` as packs, one program each, of at most `max_lanes` lanes where that is given.

    Raises:
        ValueError: a cell alone has more lanes than that.
    """
    groups: dict[Hashable, list[list[Entry]]] = {}
    for entry in entries:
        if entry.finished:
            continue
        if max_lanes is not None and entry.lanes > max_lanes:
            raise ValueError(f"{entry.name} has {entry.lanes} seeds, more than {max_lanes} lanes; a run is never split")
        packs = groups.setdefault(entry.fit(), [[]])
        if max_lanes is not None and sum(one.lanes for one in packs[-1]) + entry.lanes > max_lanes:
            packs.append([])
        packs[-1].append(entry)
    return [pack for packs in groups.values() for pack in packs]


def plan(path: Path, out: Path, max_lanes: int | None = None) -> dict[str, Any]:
    """Return the cells of a grid and the packs of those that are not finished, as plain values; nothing is written.

    Raises:
        ValueError: a cell that cannot be, or whose folder holds something else; the message names it.
    """
    entries = [_entry(cell, out) for cell in grid.read(path)]
    cells = {entry.name: {"step": entry.step, "experiment": dataclasses.asdict(entry.experiment)} for entry in entries}
    packs = [
        {
            "cells": [entry.name for entry in pack],
            "lanes": sum(entry.lanes for entry in pack),
            "step": pack[0].step,
            "steps": pack[0].experiment.steps,
            "replay_bytes": sum(entry.replay_bytes() for entry in pack),
        }
        for pack in packed(entries, max_lanes)
    ]
    return {"out": str(out), "cells": cells, "packs": packs}


def _entry(cell: grid.Cell, out: Path) -> Entry:
    """Return a cell of a grid with all that can be wrong with it found out."""
    try:
        env, setting, options = split_options(cell.env, cell.options)
        method = method_for(env, cell.algo, **options)
        experiment = Experiment.of(
            env, method, cell.seeds, cell.steps, cell.eval_every, cell.eval_episodes, cell.checkpoint_every, setting
        )
        loop, method = Loop(env, experiment.protocol(env)), per_lane(method, len(cell.seeds))
        birth.demo_rows(loop, method)
        if (out / cell.name / "config.json").is_file():
            _opened(out / cell.name, experiment)
    except ValueError as error:
        raise ValueError(f"{cell.name}: {error}") from error
    return Entry(cell.name, experiment, env, method, newest(out / cell.name / "checkpoints"))


def _opened(path: Path, experiment: Experiment) -> RunFolder:
    """Return the folder at `path` if it belongs to `experiment`; one of another run is refused and left alone."""
    folder = RunFolder.open(path)
    found, asked = (json.loads(json.dumps(dataclasses.asdict(one))) for one in (folder.experiment, experiment))
    differing = [name for name in asked if found[name] != asked[name]]
    if differing:
        told = "; ".join(f"{name} {found[name]} there, {asked[name]} in the grid" for name in differing)
        raise ValueError(
            f"{path} holds a run that differs ({told}); choose another --out, or make the grid say the same"
        )
    return dataclasses.replace(folder, experiment=experiment)


@contextlib.contextmanager
def claimed(path: Path, experiment: Experiment, logs: Sequence[str] = ()) -> Iterator[RunFolder]:
    """Give the folder at `path`, made where there is none, to this process alone until it ends."""
    if not (path / "config.json").is_file():
        RunFolder.create(path, experiment, logs)
    folder = _opened(path, experiment)
    with folder.claimed():
        yield folder


def experiment_of(fields: dict[str, Any]) -> Experiment:
    """Return the experiment of plain values, as a plan tells it."""
    return Experiment(**{**fields, "seeds": tuple(fields["seeds"])})


def work(
    out: Path,
    experiments: dict[str, Experiment],
    say: Any,
    progress: bool = True,
    devices: int | None = None,
    logs: Sequence[str] = (),
) -> bool:
    """Return whether every cell of `experiments`, by name in the sweep at `out`, is finished in the end.

    Cells are packed anew by what they have reached. `say(cell, state, ...)` hears of each: started, resumed, done, failed.
    """
    entries, folders, well = [], {}, True
    with contextlib.ExitStack() as stack:
        for name, experiment in experiments.items():
            try:
                folders[name] = stack.enter_context(claimed(inside(out, name), experiment, logs))
                env, method = experiment.build_env(), per_lane(experiment.build_method(), len(experiment.seeds))
                entries.append(Entry(name, experiment, env, method, newest(folders[name].checkpoints)))
            except (ValueError, OSError) as error:
                well = False
                say(name, "failed", why=str(error))
        for entry in entries:
            if entry.finished:
                say(entry.name, "done")
        for pack in packed(entries):
            well &= _lived(pack, folders, say, progress, devices)
    return well


def _lived(pack: list[Entry], folders: dict[str, RunFolder], say: Any, progress: bool, devices: int | None) -> bool:
    """Return whether one program with all cells of `pack` came to its end."""
    for entry in pack:
        say(entry.name, "resumed" if entry.step else "started", step=entry.step)
    try:
        runs = [Run(entry.experiment, entry.method, folders[entry.name]) for entry in pack]
        live(pack[0].env, runs, progress, devices)
    except Exception as error:  # the next pack may still be fine
        if not isinstance(error, ValueError | OSError):
            traceback.print_exc()
        for entry in pack:
            say(entry.name, "failed", why=f"{type(error).__name__}: {error}".splitlines()[0])
        return False
    for entry in pack:
        say(entry.name, "done")
    return True


def _serve(stdin: IO[str]) -> int:
    """Do the work that one line of `stdin` describes, and end at once when `stdin` does."""
    task = json.loads(stdin.readline())
    experiments = {name: experiment_of(fields) for name, fields in task["cells"].items()}
    threading.Thread(target=_end_with, args=(stdin.fileno(),), daemon=True).start()
    if "SLURM_JOB_ID" in os.environ:  # they are for submitit, which asks for another turn before this process ends
        for number in SCHEDULER_SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    def say(cell: str, state: str, **more: Any) -> None:
        print(json.dumps({"cell": cell, "state": state, **more}), flush=True)

    options = {"devices": task.get("devices"), "logs": task.get("logs", ())}
    return 0 if work(Path(task["out"]), experiments, say, **options) else 1


def _end_with(descriptor: int) -> None:
    while os.read(descriptor, 1):
        pass
    os._exit(1)


def main(arguments: list[str] | None = None) -> int:
    """Run one of the worker's two commands and return the exit code: 2 with one line on stderr for what a user got wrong."""
    parser = argparse.ArgumentParser(prog="python -m earl_jax.packs", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    planning = commands.add_parser("plan")
    planning.add_argument("grid", type=Path)
    planning.add_argument("--out", type=Path, required=True)
    planning.add_argument("--max-lanes", type=int)
    commands.add_parser("work")
    asked = parser.parse_args(arguments)
    try:
        if asked.command == "work":
            return _serve(sys.stdin)
        print(json.dumps(plan(asked.grid, asked.out, asked.max_lanes)))
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
