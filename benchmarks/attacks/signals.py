"""SIGKILL, SIGTERM and SIGINT in every part of a run, of a sweep and of a reproduction."""

import functools
import os
import signal
import time
from pathlib import Path

from benchmarks.attacks import events
from benchmarks.attacks.case import Case, Failure, require
from benchmarks.attacks.place import Place, train
from benchmarks.attacks.process import spawned
from benchmarks.kills import GRID, alive, children

EXPECTED = {
    signal.SIGKILL: "killed; the same command or resume ends with the identical table",
    signal.SIGTERM: "exit code 143, no traceback, `resume with` if there is something to resume; identical table",
    signal.SIGINT: "exit code 130, no traceback, `resume with` if there is something to resume; identical table",
}
CHANGES = 60
"""About as many changes of its folder as a run of three evaluations makes."""
PATIENCE = 1.0
"""Seconds for which a worker may outlive its launcher."""


def polite(outcome, number: int, wanted: str) -> None:
    """Expect the exit code of a stopped command and no traceback."""
    codes = (128 + number, -number) if wanted == "either" else (128 + number,)
    require(
        outcome.code in codes and "Traceback" not in outcome.err, outcome, f"exit code {128 + number}, no traceback"
    )


def continued(place: Place, folder: Path) -> str:
    """Continue a run by the command that applies, and expect the identical table."""
    command = ["resume", folder] if (folder / "metrics.csv").exists() else train(folder)
    outcome = place.run(*command)
    if outcome.code == 2 and command[0] == "train":
        outcome = place.run("resume", folder)
    return place.identical(outcome, folder)


def at_change(number: int, signum: int, place: Place) -> str:
    """Send a signal to a training run before its n-th change of its folder."""
    folder = place.path / "run"

    def before() -> None:
        events.hold_interrupts()
        events.signal_at(number, signum, folder)()

    outcome = place.run(*train(folder), before=before)
    if outcome.code == 0:
        return place.identical(outcome, folder)
    if signum == signal.SIGKILL:
        require(outcome.code == -signal.SIGKILL, outcome, "the kill")
    else:
        polite(outcome, signum, "exact")
        if any(folder.glob("checkpoints/0*")):
            require("resume" in outcome.err, outcome, "a line that says how to resume")
    continued(place, folder)
    return "continued with the identical table"


def interpreter(place: Place, signum: int, cache: str, ready, arguments=None):
    """Return the outcome of a new interpreter that gets a signal once `ready(folder)` holds."""
    folder = place.path / "run"
    environment = {"EARL_JAX_CACHE": cache, "PYTHONPATH": os.getcwd(), "PYTHONFAULTHANDLER": "1"}
    command = spawned(["-m", "earl_jax.cli", *(arguments or train(folder))], place.path, environment)
    began = time.monotonic()
    while not ready(folder, time.monotonic() - began):
        if time.monotonic() - began > 120:
            break
        time.sleep(0.02)
    left = children(command.pid)
    command.send(signum)
    return place.note(command.wait(seconds=120)), left


def in_compilation(signum: int, seconds: float, place: Place) -> str:
    """Send a signal `seconds` after config.json appeared, while programs compile; the interpreter ends by itself."""
    seen: list[float] = []

    def ready(folder: Path, now: float) -> bool:
        if (folder / "config.json").exists() and not seen:
            seen.append(now)
        return bool(seen) and now - seen[0] >= seconds

    outcome, _ = interpreter(place, signum, str(place.path / "cold"), ready)
    if signum != signal.SIGKILL:
        polite(outcome, signum, "exact")
    return continued(place, place.path / "run")


def at_import(signum: int, seconds: float, place: Place) -> str:
    """Send a signal while the package is imported."""
    outcome, _ = interpreter(place, signum, str(place.path / "cold"), lambda folder, now: now >= seconds)
    require(outcome.code in (-signum, 128 + signum), outcome, "the end of the process")
    require("Traceback" not in outcome.err or signum == signal.SIGINT, outcome, "no traceback")
    return "ended before it began"


def launcher(name: str, signum: int, place: Place) -> str:
    """Send a signal to the launcher of a sweep or a reproduction after the first checkpoint, then repeat the command."""
    folder = place.path / "run"
    if name == "sweep":
        (place.path / "grid.toml").write_text(GRID)
        arguments = ["sweep", "grid.toml", "--out", str(folder)]
    else:
        arguments = ["reproduce", "table1", "--steps", "400", "--out", str(folder), "--set", "eval_horizon=40"]
    from earl_jax.training.program_cache import folder as programs

    outcome, left = interpreter(
        place, signum, str(programs()), lambda folder, now: any(folder.rglob("checkpoints/0*")), arguments
    )
    began = time.monotonic()
    while any(map(alive, left)):
        if time.monotonic() - began > PATIENCE:
            raise Failure(f"a worker outlived its launcher by more than {PATIENCE} s")
        time.sleep(0.005)
    if signum != signal.SIGKILL and outcome.code != 0:
        polite(outcome, signum, "either")
    second = place.run(*arguments, seconds=300)
    require(second.code == 0, second, "a finished sweep")
    if name == "sweep":
        whole = place.path / "whole"
        outcome = place.run(*arguments[:-1], whole, seconds=300)
        require(outcome.code == 0, outcome, "a finished sweep")
        if tables_of(folder) != tables_of(whole):
            raise Failure("the tables differ from those of an uninterrupted sweep")
    return "continued with the identical tables"


def tables_of(folder: Path) -> dict[str, bytes]:
    """Return the tables below a folder by their paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("metrics.csv"))}


def cases() -> list[Case]:
    """Return signals at changes of the folder, in imports and compilations, and to launchers."""
    kinds = {"SIGKILL": (signal.SIGKILL, 1), "SIGTERM": (signal.SIGTERM, 4), "SIGINT": (signal.SIGINT, 4)}
    changes = [
        Case(
            f"{name} before change {number} of the folder",
            EXPECTED[signum],
            functools.partial(at_change, number, signum),
        )
        for name, (signum, every) in kinds.items()
        for number in range(1, CHANGES + 1, every)
    ]
    ends = [
        Case(
            f"{name} {seconds} s into compilation", EXPECTED[signum], functools.partial(in_compilation, signum, seconds)
        )
        for name, (signum, _) in kinds.items()
        for seconds in (0.5, 3.0)
    ]
    imports = [
        Case(f"{name} {seconds} s into the import", "the process ends, without a traceback on SIGTERM",
             functools.partial(at_import, signum, seconds))
        for name, (signum, _) in kinds.items()
        for seconds in (0.1, 1.0)
    ]  # fmt: skip
    launchers = [
        Case(
            f"{name} to the launcher of a {command}", f"no worker after {PATIENCE} s; repeated: identical tables",
            functools.partial(launcher, command, signum),
        )
        for name, (signum, _) in kinds.items()
        for command in ("sweep", "reproduction")
    ]  # fmt: skip
    return [*changes, *ends, *imports, *launchers]
