"""More seeds for a finished run: the folder where they are trained, and its merging into the folder of the run.

The new seeds have a run folder of their own in that of the run, `new_seeds`. When it is finished, the merged files are
written to `merged_seeds` there and moved into place one by one. That folder is in the run folder while they are moved, so
that after a kill nobody reads half of them and the same command goes on.
"""

import dataclasses
import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import CHECKPOINTS, CONFIG, MERGED, METRICS, NEW_SEEDS, POLICIES
from earl_jax.runs.files import LOCK, locked, write_atomically
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.table import Table

MOVED = (CHECKPOINTS, POLICIES, METRICS, CONFIG)
"""What is moved into place; the config last, because it says which seeds the run has."""


def missing_seeds(config: RunConfig, wanted: Iterable[int]) -> tuple[int, ...]:
    """Return those of the seeds `wanted` that the run `config` lacks, in their order."""
    own = set(config.seeds)
    return tuple(seed for seed in dict.fromkeys(wanted) if seed not in own)


def new_seeds_folder(folder: RunFolder, seeds: Sequence[int], engine: str) -> RunFolder:
    """Return the folder in which `seeds` are trained for the run in `folder`, created or opened to continue.

    Raises:
        ValueError: other seeds are being added to the run.
    """
    path = folder.path / NEW_SEEDS
    config = dataclasses.replace(folder.config, seeds=tuple(seeds))
    if not (path / CONFIG).is_file():
        return RunFolder.create(path, config, engine)
    existing = RunFolder.open(path)
    if existing.config.values != config.values:
        named = " ".join(map(str, existing.config.seeds))
        raise InputError(
            f"{path} holds the unfinished seeds {named}; finish them with: earl-jax resume {folder.path} --seeds {named}, "
            f"or delete {path}"
        )
    return existing


def merge(folder: RunFolder, added: RunFolder, write_state: Callable[[RunFolder], None]) -> RunFolder:
    """Return `folder` with the seeds of the finished run `added`, which is removed.

    `write_state` writes policies and the checkpoint of all seeds to the folder that it receives.

    Raises:
        ValueError: the tables of the runs have other columns; `folder` is unchanged.
    """
    part = added.path / MERGED
    shutil.rmtree(part, ignore_errors=True)  # a kill left it
    part.mkdir()
    config = dataclasses.replace(folder.config, seeds=(*folder.config.seeds, *added.config.seeds))
    merged = RunFolder(part, config, folder.logs)
    write_atomically(merged.metrics, merged_table(folder, added))
    write_state(merged)
    write_atomically(merged.config_file, merged_config(folder, added, config))
    part.rename(folder.path / MERGED)
    _move_merged(folder.path)
    return RunFolder.open(folder.path)


def finish_merge(path: Path) -> None:
    """Move the merged files into the run folder at `path` if a kill has stopped that.

    Raises:
        ValueError: another process is merging there.
    """
    if (path / MERGED).is_dir():
        with locked(path):
            _move_merged(path)


def _move_merged(path: Path) -> None:
    part = path / MERGED
    for name in MOVED:
        if not (part / name).exists():
            continue
        if (path / name).is_dir():
            shutil.rmtree(path / name)
        (part / name).rename(path / name)
    shutil.rmtree(path / NEW_SEEDS, ignore_errors=True)
    (part / LOCK).unlink(missing_ok=True)
    part.rmdir()


def merged_table(folder: RunFolder, added: RunFolder) -> str:
    """Return the text of the metrics.csv of both runs, each evaluation with the seeds of `folder` first.

    Raises:
        ValueError: the tables have other columns, or one of them is not complete.
    """
    runs = [(run, Table.read(run.metrics, run.config)) for run in (folder, added)]
    tables = [table for _, table in runs]
    for run, table in runs:
        if table.problem or table.step < run.config.steps:
            raise InputError(f"{run.metrics} ends at step {table.step} of {run.config.steps} {table.problem}".rstrip())
    if tables[0].columns != tables[1].columns:
        differing = sorted(set(tables[0].columns) ^ set(tables[1].columns)) or ["their order"]
        raise InputError(
            f"{folder.metrics} and {added.metrics} differ in their columns ({', '.join(differing)}): another version wrote "
            "them. Train the seeds in a folder of their own with: earl-jax train --config; compare and plot pool them"
        )
    lines = [tables[0].lines[0]]
    for number in range(folder.config.steps // folder.config.eval_every):
        for run, table in runs:
            count = len(run.config.seeds)
            lines += table.lines[1 + number * count : 1 + (number + 1) * count]
    return "".join(f"{line}\n" for line in lines)


def merged_config(folder: RunFolder, added: RunFolder, config: RunConfig) -> str:
    """Return the text of the config.json of both runs; `added` lists later seeds with their own provenance."""
    values, more = (json.loads(run.config_file.read_text()) for run in (folder, added))
    origin = {"seeds": list(added.config.seeds), "engine": more.get("engine"), "provenance": more.get("provenance")}
    values |= {"seeds": list(config.seeds), "added": [*values.get("added", []), origin]}
    return json.dumps(values, indent=2) + "\n"
