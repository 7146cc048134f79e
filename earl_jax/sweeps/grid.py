"""A grid in a TOML file: tasks x methods x options, one run for each combination.

Names and numbers are checked when a run is planned, by the classes that use them.
"""

import dataclasses
import hashlib
import itertools
import os
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError
from earl_jax.options import imports
from earl_jax.options.presets import Preset, named_preset
from earl_jax.options.schedule import FIELDS, Schedule
from earl_jax.options.seeds import seed_list
from earl_jax.options.values import check_storable, parse_number

KEYS = ("preset", "envs", "algos", "seeds", *FIELDS, "options")
MOST_RUNS = 10_000
"""The largest number of runs in a grid."""
NULL = "null"
"""The value of an option that is None; TOML has no null."""
LONGEST = 150
"""Longest folder name in characters. A longer name is cut, and a hash keeps it unique."""


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """One run of a grid: a task, a method, one combination of options, seeds and a schedule."""

    env: str
    algo: str
    options: dict[str, Any]
    seeds: tuple[int, ...]
    schedule: Schedule

    @property
    def name(self) -> str:
        """Folder of the run in that of the sweep. It depends on the task, the method and the options alone."""
        exact = ",".join(f"{name}={_text(value)}" for name, value in sorted(self.options.items())) or "default"
        safe = re.sub(r"[^A-Za-z0-9._=,+-]", "_", exact)
        if safe != exact or len(safe) > LONGEST:
            safe = f"{safe[: LONGEST - 9]}-{hashlib.blake2b(exact.encode(), digest_size=4).hexdigest()}"
        return f"{self.env}/{self.algo}/{safe}"


def read(path: Path) -> list[RunSpec]:
    """Return the runs of the grid in a TOML file, each once; of two runs with one name the later one counts.

    Raises:
        ValueError: the file cannot be read, or has an unknown key or an invalid value; the message names it.
    """
    table = read_table(path)
    specs: dict[str, RunSpec] = {}
    try:
        for spec in itertools.chain.from_iterable(map(block_specs, _blocks(table))):
            specs[spec.name] = spec
            if len(specs) > MOST_RUNS:
                raise InputError(f"it has more than {MOST_RUNS} runs; split it over several grids")
    except InputError as error:
        raise InputError(f"grid {path}: {error}") from error
    return list(specs.values())


def read_table(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file, without the files of its `import`, which are run. Errors as `read`."""
    try:
        table = tomllib.loads(path.read_text("utf-8-sig"), parse_float=parse_number)
        for file in _names(table, "import") if "import" in table else ():
            imports.note(os.path.abspath(path.parent / file))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} can't be read: {error}") from error
    imports.run_noted()
    return {key: value for key, value in table.items() if key != "import"}


def _blocks(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the top level of a grid, if it names runs, and its [[runs]] tables with the values that they inherit."""
    common = {key: value for key, value in table.items() if key != "runs"}
    runs = table.get("runs", [])
    if not isinstance(runs, list) or not all(isinstance(run, dict) for run in runs):
        raise InputError("runs must be tables: [[runs]]")
    top = [common] if {"envs", "algos"} <= set(common) or not runs else []
    return top + [{**common, **run, "options": {**options_of(common), **options_of(run)}} for run in runs]


def block_specs(block: dict[str, Any]) -> Iterator[RunSpec]:
    """Yield the run of every combination in one block of a grid. Errors as `read`."""
    for key in block:
        if key not in KEYS:
            raise InputError(f"unknown key {key!r}; choose from {', '.join(KEYS)}; above [[runs]], import is one too")
    envs, algos = _names(block, "envs"), _names(block, "algos")
    for env in envs:
        preset = named_preset(str(block["preset"]), env, block.get("steps")) if "preset" in block else Preset()
        schedule = preset.schedule.changed(**{key: block[key] for key in FIELDS if key in block})
        schedule.check()
        seeds = seed_list(block.get("seeds", preset.seeds))
        own = {name: [list(value)] if isinstance(value, tuple) else value for name, value in preset.options.items()}
        alternatives = _alternatives({**own, **options_of(block)})  # a list in it holds alternatives
        for algo, *values in itertools.product(algos, *alternatives.values()):
            options = dict(zip(alternatives, values, strict=True))
            yield RunSpec(env=env, algo=algo, options=options, seeds=seeds, schedule=schedule)


def options_of(block: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a block. Errors as `read`."""
    options = block.get("options", {})
    if not isinstance(options, dict):
        raise InputError("options must be a table: [options]")
    for name, value in options.items():
        check_storable(f"option {name}", value)
    return options


def _names(block: dict[str, Any], key: str) -> list[str]:
    names = block.get(key, [])
    names = [names] if isinstance(names, str) else names
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(f'{key} must contain at least one name, as in {key} = ["..."]')
    return names


def _alternatives(options: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the alternative values of each option, sorted by the names of the options."""
    alternatives = {}
    for name, value in sorted(options.items()):
        listed = value if isinstance(value, list) else [value]
        alternatives[name] = values = list(map(without_null, listed))
        if name == "hidden_sizes" and not all(isinstance(value, list) for value in values):
            raise InputError(
                f"option hidden_sizes = {value} is a single alternative with one size per layer; write it as [{listed}]"
            )
        if not values or len(set(map(_text, values))) < len(values):
            raise InputError(
                f"option {name} = {values} must list at least one value, each once; a list holds alternatives"
            )
        if isinstance(values[0], dict):
            raise InputError(f"option {name} is for a search: earl-jax search draws options from distributions")
    return alternatives


def without_null(value: Any) -> Any:
    """Return a value of TOML as an option takes it: None for `NULL`."""
    return None if value == NULL else value


def _text(value: Any) -> str:
    if isinstance(value, list):
        return "x".join(map(_text, value))
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return NULL
    return f"{value:.12g}" if isinstance(value, int | float) else str(value)
