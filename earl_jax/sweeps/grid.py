"""A grid in a TOML file: tasks x methods x options, one run for each combination. It imports no learner."""

import dataclasses
import hashlib
import itertools
import json
import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError
from earl_jax.options import seed_list
from earl_jax.presets import LENGTHS, preset

COUNTS = {name: count for name, count in LENGTHS.items() if name != "seeds"}
KEYS = ("preset", "envs", "algos", "seeds", *COUNTS, "options")
SEARCH_KEYS = ("samples", "sampler", "sample_seed")
SAMPLERS = ("tpe", "random", "qmc")
KINDS = ("uniform", "log_uniform", "integers", "choice")
"""The samplers of a search, and its distributions of options."""
MOST_RUNS, MOST_SEEDS = 10_000, 65_536
"""The largest numbers of runs in a grid and of seeds in a run."""
LONGEST = 150
"""Longest folder name in characters. A longer name is cut, and a hash keeps it unique."""


@dataclasses.dataclass(frozen=True)
class RunSpec:
    """One run of a grid: a task, a method, one combination of options, seeds and lengths."""

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
        """Folder of the run in the folder of the sweep. It depends on the task, the method and the options alone."""
        return f"{self.env}/{self.algo}/{_slug(self.options)}"


def read(path: Path) -> list[RunSpec]:
    """Return the runs of the grid in a TOML file, each once; of two runs with one name the later one counts.

    Raises:
        ValueError: the file cannot be read, or has an unknown key or an invalid value; the message names it.
    """
    table = _read_table(path)
    try:
        specs: dict[str, RunSpec] = {}
        for block in _blocks(table):
            specs.update((spec.name, spec) for spec in _specs(block))
            _check_runs(len(specs))
    except ValueError as error:
        raise InputError(f"grid {path}: {error}") from error
    return list(specs.values())


def read_space(path: Path) -> tuple[RunSpec, dict[str, dict[str, Any]], str]:
    """Return the run of a file with one task and one method, the distributions of its other options, and its sampler.

    Raises:
        ValueError: as `read`, or there are several tasks, methods or values of an option, or no distribution.
    """
    table = _read_table(path)
    try:
        if "runs" in table:
            raise InputError("a search has no [[runs]]; it draws the options of its runs itself")
        options = _options(table)
        distributions = {name: value for name, value in options.items() if isinstance(value, dict)}
        if not distributions:
            raise InputError("a search needs options with a distribution, such as { log_uniform = [1e-4, 1e-2] }")
        fixed = {name: value for name, value in options.items() if name not in distributions}
        for name, distribution in distributions.items():
            _check_distribution(name, distribution)
        sampler = table.pop("sampler", SAMPLERS[0])
        if sampler not in SAMPLERS:
            raise InputError(f"unknown sampler {sampler!r}; choose from {', '.join(SAMPLERS)}")
        specs = list(_specs({**table, "options": fixed}))
        if len(specs) > 1:
            raise InputError(
                "a search has one task, one method and one value of each option; a list can be a choice = [...]"
            )
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    preset_names = distributions.keys() & specs[0].options.keys()
    options = {name: value for name, value in specs[0].options.items() if name not in preset_names}
    return dataclasses.replace(specs[0], options=options), distributions, sampler


def _read_table(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"grid {path} can't be read: {error}") from error


def _blocks(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the top level of a grid, if it names runs, and its [[runs]] tables with the values that they inherit."""
    common = {key: value for key, value in table.items() if key != "runs"}
    runs = table.get("runs", [])
    if not isinstance(runs, list) or not all(isinstance(run, dict) for run in runs):
        raise InputError("runs must be tables: [[runs]]")
    top = [common] if {"envs", "algos"} <= set(common) or not runs else []
    return top + [{**common, **run, "options": {**_options(common), **_options(run)}} for run in runs]


def _specs(block: dict[str, Any]) -> Iterator[RunSpec]:
    """Yield the run of every combination in one block of a grid."""
    distributions = [name for name, value in _options(block).items() if isinstance(value, dict)]
    for name in [*(key for key in SEARCH_KEYS if key in block), *distributions]:
        raise InputError(f"{name} is for a search: earl-jax search draws options from distributions, with a sampler")
    for key in block:
        if key not in KEYS:
            raise InputError(f"unknown key {key!r}; choose from {', '.join(KEYS)}, or a [[runs]] table of them")
    envs, algos = _names(block, "envs"), _names(block, "algos")
    for env in envs:
        own = _with_preset(block, env)
        counts = {key: _count(key, own.get(key, default)) for key, default in COUNTS.items()}
        seeds = _seeds(own.get("seeds", LENGTHS["seeds"]))
        alternatives = _alternatives(_options(own))
        _check_runs(math.prod(map(len, (envs, algos, *alternatives.values()))))
        for algo, *values in itertools.product(algos, *alternatives.values()):
            options = dict(zip(alternatives, values, strict=True))
            yield RunSpec(env=env, algo=algo, options=options, seeds=seeds, **counts)


def _check_distribution(option: str, distribution: dict[str, Any]) -> None:
    kind, ends = next(iter(distribution.items())) if len(distribution) == 1 else ("", None)
    if kind not in KINDS:
        raise InputError(
            f"option {option} = {distribution} must be one of {', '.join(KINDS)}, as in {{ log_uniform = [1e-5, 1e-2] }}"
        )
    if not isinstance(ends, list) or not ends or (kind != "choice" and not _are_ends(kind, ends)):
        wanted = "a list of values" if kind == "choice" else "two numbers, the smaller one first"
        more = {"log_uniform": ", both above 0", "integers": ", both whole"}.get(kind, "")
        raise InputError(f"option {option}: {kind} takes {wanted}{more}, not {ends}")


def _are_ends(kind: str, ends: list[Any]) -> bool:
    types = (int,) if kind == "integers" else (int, float)
    if len(ends) != 2 or not all(type(end) in types and math.isfinite(end) for end in ends):
        return False
    return ends[0] < ends[1] and (kind != "log_uniform" or ends[0] > 0)


def _with_preset(block: dict[str, Any], env: str) -> dict[str, Any]:
    """Return `block` with the lengths and options of its preset, if it names one, for a task; its own values win."""
    if "preset" not in block:
        return block
    given = {key: block[key] for key in ("seeds", *COUNTS) if key in block}
    values = preset(str(block["preset"]), env, **given)
    lengths = {key: values.pop(key) for key in LENGTHS}
    options = {name: [list(value)] if isinstance(value, tuple) else value for name, value in values.items()}
    return {**block, **lengths, "options": {**options, **_options(block)}}


def _check_runs(count: int) -> None:
    if count > MOST_RUNS:
        raise InputError(f"it has more than {MOST_RUNS} runs; split it over several grids")


def _names(block: dict[str, Any], key: str) -> list[str]:
    names = block.get(key, [])
    names = [names] if isinstance(names, str) else names
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(f'{key} must contain at least one name, as in {key} = ["..."]')
    return names


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _count(key: str, value: Any) -> int:
    if not _is_integer(value) or value < 1:
        raise InputError(f"{key} must be a whole number of at least 1, not {value!r}")
    return value


def _seeds(value: Any) -> tuple[int, ...]:
    if not isinstance(value, str) and not (isinstance(value, list) and all(map(_is_integer, value))):
        value = _count("seeds", value)
    seeds = seed_list(value)
    if not seeds:
        raise InputError(f"seeds must be at least one, not {value!r}")
    if len(seeds[MOST_SEEDS : MOST_SEEDS + 1]):  # a range can have more values than len() can count
        raise InputError(f"seeds must be at most {MOST_SEEDS}; split them over several runs")
    return tuple(seeds)


def _options(block: dict[str, Any]) -> dict[str, Any]:
    options = block.get("options", {})
    if not isinstance(options, dict):
        raise InputError("options must be a table: [options]")
    return options


def _alternatives(options: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the alternative values of each option, sorted by the names of the options."""
    alternatives = {name: value if isinstance(value, list) else [value] for name, value in sorted(options.items())}
    for name, values in alternatives.items():
        texts = [json.dumps(value, default=str) for value in values]
        if not texts or len(set(texts)) < len(texts):
            raise InputError(
                f"option {name} = {options[name]} must list at least one value, each once; a list holds alternatives"
            )
        if name == "hidden_sizes" and not all(isinstance(value, list) for value in values):
            raise InputError(
                f"option hidden_sizes = {options[name]} is a single alternative with one size per layer; "
                "write it as [[256, 256]]"
            )
    return alternatives


def _slug(options: dict[str, Any]) -> str:
    """Return options as a folder name: readable if possible, and the same for the same options."""
    exact = ",".join(f"{name}={_text(value)}" for name, value in sorted(options.items())) or "default"
    safe = re.sub(r"[^A-Za-z0-9._=,+-]", "_", exact)
    if safe == exact and len(safe) <= LONGEST:
        return safe
    return f"{safe[: LONGEST - 9]}-{hashlib.blake2b(exact.encode(), digest_size=4).hexdigest()}"


def _text(value: Any) -> str:
    if isinstance(value, list):
        return "x".join(map(_text, value))
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.12g}" if isinstance(value, int | float) else str(value)
