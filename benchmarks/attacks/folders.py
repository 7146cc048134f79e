"""Names that a run cannot have, folders of others, and starts that a rejection or a crash left half done."""

import functools
import json
import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

from benchmarks.attacks import events
from benchmarks.attacks.case import Case, refused, refused_arguments, require, unchanged
from benchmarks.attacks.place import Place, train

REFUSED = "one line, exit code 2, nothing changed"
TAKEN = "the same command takes the folder over and ends with the identical table"


def thesis(folder: Path) -> None:
    """Make a folder with somebody's work."""
    folder.mkdir()
    (folder / "thesis.tex").write_text("all of it")


def file(folder: Path) -> None:
    """Put a file in the place of the folder."""
    folder.write_text("x")


def dangling(folder: Path) -> None:
    """Put a link to nothing in the place of the folder."""
    folder.symlink_to("nowhere")


def loop(folder: Path) -> None:
    """Put a loop in the place of the folder."""
    folder.symlink_to(folder.name)


def pipe(folder: Path) -> None:
    """Put a named pipe in the place of the folder."""
    os.mkfifo(folder)


def hidden(folder: Path) -> None:
    """Make a folder with a hidden file."""
    folder.mkdir()
    (folder / ".git").write_text("x")


BLOCKED: dict[str, Callable[[Path], None]] = {
    "a folder with a thesis": thesis, "a file": file, "a dangling link": dangling, "a loop": loop, "a named pipe": pipe,
    "a folder with a hidden file": hidden,
}  # fmt: skip


def blocked(make: Callable[[Path], None], overwrite: bool, place: Place) -> str:
    """Train into a name that is taken by something else."""
    make(place.path / "run")
    with unchanged(place.path):
        return refused(place.run(*train("run", more=("--overwrite",) if overwrite else ())))


def begun(overwrite: bool, keep: str, place: Place) -> str:
    """Train into a folder where a run began."""
    folder = place.unfinished() if keep == "checkpoint" else place.finished()
    if overwrite:
        return place.identical(place.run(*train("run", more=("--overwrite",))), folder)
    with unchanged(folder):
        return refused(place.run(*train("run")), "resume")


def start_left(leave: Callable[[Path], None], command: str, place: Place) -> str:
    """Start, keep of the folder what a crash leaves, and start again."""
    folder = place.finished()
    leave(folder)
    arguments = train(folder) if command == "train" else ["resume", folder]
    return place.identical(place.run(*arguments), folder)


def only_config(folder: Path) -> None:
    """Keep config.json."""
    for path in folder.iterdir():
        if path.name != "config.json":
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def only_part(folder: Path) -> None:
    """Keep half of config.json under the name of a file that is being written."""
    text = (folder / "config.json").read_text()
    only_config(folder)
    (folder / "config.json").unlink()
    (folder / "config.json.part").write_text(text[: len(text) // 2])


def no_table(folder: Path) -> None:
    """Keep config.json and an empty folder of checkpoints."""
    only_config(folder)
    (folder / "checkpoints").mkdir()


def part_checkpoint(folder: Path) -> None:
    """Keep config.json and a checkpoint that was not finished."""
    only_config(folder)
    (folder / "checkpoints" / "part-40").mkdir(parents=True)


LEFT = {
    "only config.json": only_config,
    "half of config.json": only_part,
    "no table": no_table,
    "a part of a checkpoint": part_checkpoint,
}


def rejected(place: Place) -> str:
    """Start with an option that is rejected late, and start again without it."""
    folder = place.path / "run"
    refused_arguments(place.run(*train(folder, more=("--devices", "1000"))))
    require(not folder.exists() or not (folder / "metrics.csv").exists(), place.outcomes[-1], "no table")
    return place.identical(place.run(*train(folder)), folder)


def crashed(place: Place) -> str:
    """Start, crash before the first evaluation, and start again with other options."""
    folder = place.path / "run"
    before = functools.partial(lambda act: act(), events.signal_at(4, signal.SIGKILL, folder))
    place.run(*train(folder), before=before)
    return place.identical(place.run(*train(folder)), folder)


def other_config(place: Place) -> str:
    """Start another run in a folder in which only the config of a run is."""
    folder = place.finished()
    only_config(folder)
    values = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**values, "algo": "naive"}))
    outcome = place.run(*train("run"))
    return place.identical(outcome, folder) if outcome.code == 0 else refused(outcome)


NAMES = ("run with spaces", "run\nnewline", "😀", "-run", "..", ".", "a/../run", "x" * 255, "x" * 256, "/".join(["x" * 200] * 25),
         "run\x1b[31m", "~", "$HOME", "*", "con", "run.", "\ud800")  # fmt: skip


def named(name: str, place: Place) -> str:
    """Train into a folder of an unusual name."""
    arguments = train("run")
    arguments[arguments.index("run")] = f"--out={name}"
    arguments.remove("--out")
    outcome = place.run(*arguments)
    if outcome.code == 0:
        return place.identical(outcome, place.path / name)
    return refused_arguments(outcome)


def cases() -> list[Case]:
    """Return taken names, runs that began, starts that were left, and unusual names."""
    either = "the identical table, or one line"
    return [
        *(
            Case(f"{name}{' with --overwrite' * overwrite}", REFUSED, functools.partial(blocked, make, overwrite),
                 fast=not overwrite and make is not pipe)
            for name, make in BLOCKED.items()
            for overwrite in (False, True)
        ),
        *(
            Case(f"a run that began, with a {keep}{' and --overwrite' * overwrite}",
                 "the identical table" if overwrite else REFUSED, functools.partial(begun, overwrite, keep), fast=not overwrite)
            for keep in ("checkpoint", "table")
            for overwrite in (False, True)
        ),
        *(
            Case(f"{name} was left, then {command}", TAKEN, functools.partial(start_left, leave, command))
            for name, leave in LEFT.items()
            for command in ("train", "resume")
            if (name, command) != ("half of config.json", "resume")
        ),
        Case("a rejected start", TAKEN, rejected),
        Case("a crash before the first evaluation", TAKEN, crashed),
        Case("another start in a folder with only a config", f"{TAKEN}, or one line", other_config),
        *(
            Case(f"a folder named {ascii(name)[:40]} ({len(name)})", either, functools.partial(named, name))
            for name in NAMES
        ),
    ]  # fmt: skip
