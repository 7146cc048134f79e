"""A sweep as a TOML file: tasks x methods x options, a cell each. Reading it needs no learner."""

import dataclasses
import hashlib
import itertools
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

COUNTS = {"steps": 100_000, "eval_every": 10_000, "eval_episodes": 10, "checkpoint_every": 100_000}
KEYS = ("envs", "algos", "seeds", *COUNTS, "options")
LONGEST = 150
"""Characters of a folder's name; a longer one is cut and told apart by a hash."""


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """One run of a sweep: a task, a method, one combination of options, and what `earl-jax train` takes besides."""

    env: str
    algo: str
    options: dict[str, Any]
    seeds: tuple[int, ...]
    steps: int
    eval_every: int
    eval_episodes: int
    checkpoint_every: int

    @property
    def name(self) -> str:
        """The folder of the run inside the sweep's: task, method and options, whatever the file says in other places."""
        return f"{self.env}/{self.algo}/{_slug(self.options)}"


def read(path: Path) -> list[RunSpec]:
    """Return the cells of the grid in a TOML file, each one once; of two with one name the later one counts.

    Raises:
        ValueError: the file can't be read or says something that a grid has no place for; the message names it.
    """
    try:
        table = tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"grid {path} can't be read: {error}") from error
    try:
        runs = table.pop("runs", [])
        if not isinstance(runs, list) or not all(isinstance(run, dict) for run in runs):
            raise ValueError("runs are tables: [[runs]]")
        blocks = [table] if {"envs", "algos"} <= set(table) or not runs else []
        blocks += [{**table, **run, "options": {**_options(table), **_options(run)}} for run in runs]
        cells = {cell.name: cell for block in blocks for cell in _cells(block)}
    except ValueError as error:
        raise ValueError(f"grid {path}: {error}") from error
    return list(cells.values())


def _cells(block: dict[str, Any]) -> Iterator[RunSpec]:
    """Yield every combination in one block of a grid."""
    for key in block:
        if key not in KEYS:
            raise ValueError(f"no key {key!r}; choose from {', '.join(KEYS)}, or a [[runs]] table of them")
    counts = {key: _count(key, block.get(key, default)) for key, default in COUNTS.items()}
    seeds, choices = _seeds(block.get("seeds", 5)), _alternatives(_options(block))
    for env, algo in itertools.product(_names(block, "envs"), _names(block, "algos")):
        for values in itertools.product(*choices.values()):
            yield RunSpec(env, algo, dict(zip(choices, values, strict=True)), seeds, **counts)


def _names(block: dict[str, Any], key: str) -> list[str]:
    names = block.get(key, [])
    names = [names] if isinstance(names, str) else names
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise ValueError(f'{key} must name at least one, as in {key} = ["..."]')
    return names


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _count(key: str, value: Any) -> int:
    if not _whole(value) or value < 1:
        raise ValueError(f"{key} must be a whole number of at least 1, not {value!r}")
    return value


def _seeds(value: Any) -> tuple[int, ...]:
    if isinstance(value, list) and all(map(_whole, value)):
        return tuple(value)
    return tuple(range(_count("seeds", value)))


def _options(block: dict[str, Any]) -> dict[str, Any]:
    options = block.get("options", {})
    if not isinstance(options, dict):
        raise ValueError("options are a table: [options]")
    return options


def _alternatives(options: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the values that each option takes in turn, by name in order."""
    choices = {name: value if isinstance(value, list) else [value] for name, value in sorted(options.items())}
    for name, values in choices.items():
        told = [json.dumps(value, default=str) for value in values]
        if not told or len(set(told)) < len(told):
            raise ValueError(f"option {name} = {options[name]} lists no value, or one twice; a list holds alternatives")
        if name == "hidden_sizes" and not all(isinstance(value, list) for value in values):
            raise ValueError(f"option hidden_sizes = {options[name]} is one value a layer: write it as [[256, 256]]")
    return choices


def _slug(options: dict[str, Any]) -> str:
    """Return options as a folder name, the same for the same options, in words where they fit."""
    exact = ",".join(f"{name}={_told(value)}" for name, value in sorted(options.items())) or "default"
    safe = re.sub(r"[^A-Za-z0-9._=,+-]", "_", exact)
    if safe == exact and len(safe) <= LONGEST:
        return safe
    return f"{safe[: LONGEST - 9]}-{hashlib.blake2b(exact.encode(), digest_size=4).hexdigest()}"


def _told(value: Any) -> str:
    if isinstance(value, list):
        return "x".join(map(_told, value))
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, int | float) else str(value)
