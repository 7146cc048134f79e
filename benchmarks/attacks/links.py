"""Links and special files inside run folders, by which a command could read or write elsewhere."""

import functools
import os
import shutil
from collections.abc import Callable
from pathlib import Path

from benchmarks.attacks.case import Case, Failure, first, refused, require
from benchmarks.attacks.place import STEPS, Place

EXPECTED = "one line, at the latest at the first write, or the right result; nothing outside is written, nothing waits"
NAMES = (
    "config.json", "config.json.part", "metrics.csv", "metrics.csv.part", "policies.npz", "policies.npz.part", "checkpoints",
    "tensorboard", ".lock", f"checkpoints/{STEPS:09d}", "checkpoints/part-120", "checkpoints/000000080/manifest.json",
    "checkpoints/000000080/lanes", "checkpoints/000000080/replay",
)  # fmt: skip
COMMANDS = {
    "resume": ("resume", "run"),
    "evaluate": ("evaluate", "run", "--episodes", "1"),
    "table": ("table", "run"),
    "report": ("report", "run"),
}


def to_file(place: Place, path: Path) -> None:
    """Link to the file outside."""
    path.symlink_to(place.outside / "secret.txt")


def to_folder(place: Place, path: Path) -> None:
    """Link to the folder outside."""
    path.symlink_to(place.outside)


def to_new(place: Place, path: Path) -> None:
    """Link to a file outside that does not exist."""
    path.symlink_to(place.outside / "new.txt")


def to_itself(place: Place, path: Path) -> None:
    """Make a loop."""
    path.symlink_to(path.name)


def to_moved(place: Place, path: Path) -> None:
    """Move the original elsewhere and link to it, as people do who have a large disk."""
    elsewhere = place.path / "elsewhere"
    shutil.move(place.path / "original", elsewhere)
    path.symlink_to(elsewhere)


def hard(place: Place, path: Path) -> None:
    """Give the file outside a second name."""
    os.link(place.outside / "secret.txt", path)


def pipe(place: Place, path: Path) -> None:
    """Make a named pipe, whose opening waits."""
    os.mkfifo(path)


KINDS: dict[str, Callable[[Place, Path], None]] = {
    "link to a file": to_file, "link to a folder": to_folder, "link to a new file": to_new, "loop": to_itself,
    "link to the original elsewhere": to_moved, "hard link": hard, "named pipe": pipe,
}  # fmt: skip


def attack(command: str, name: str, make: Callable[[Place, Path], None], place: Place) -> str:
    """Put a link in the place of a file and run a command; `check_outside` follows every case."""
    folder = place.unfinished()
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    if path.exists():
        shutil.move(path, place.path / "original")
    elif make is to_moved:
        (place.path / "original").mkdir()
    make(place, path)
    outcome = place.run(*COMMANDS[command], seconds=60)
    place.check_outside()
    return first(lambda: refused(outcome), lambda: _right(place, command, outcome, folder), lambda: _late(outcome))


def _late(outcome) -> str:
    """Expect that training stopped with one error line when it reached the file; what was there before is intact."""
    last = outcome.err.strip().splitlines()[-1:]
    stopped = outcome.code == 2 and "Traceback" not in outcome.err and last and last[0].startswith("earl-jax: ")
    require(stopped, outcome, "one line at the first write")
    return "stopped with one line at the first write"


def _right(place: Place, command: str, outcome, folder: Path) -> str:
    if command == "resume":
        return place.identical(outcome, folder)
    if command == "report" and outcome.code == 2 and "none of the runs" in outcome.err:
        return "refused with the cause"
    require(outcome.code == 0 and "Traceback" not in outcome.err, outcome, "exit code 0, or one line")
    return "read without writing"


def sweep_through(name: str, place: Place) -> str:
    """Sweep into a folder in which `name` is a link to the folder outside."""
    (place.path / "grid.toml").write_text(
        'envs = ["tabletop_organization"]\nalgos = ["naive"]\nsteps = 40\neval_every = 40\nseeds = 1\neval_episodes = 1\n'
        "[options]\nhidden_sizes = [[16, 16]]\nbatch_size = 16\nrandom_steps = 20\n"
    )
    link = place.path / name
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(place.outside)
    outcome = place.run("sweep", "grid.toml", "--out", "out", seconds=120)
    if any(path.name != "secret.txt" for path in place.outside.iterdir()):
        raise Failure("the sweep wrote through a link inside its folder")
    require(outcome.code in (1, 2) and "Traceback" not in outcome.err, outcome, "a failed run or one line")
    return "refused in one line" if outcome.code == 2 else "the run failed with its cause"


def cases() -> list[Case]:
    """Return every kind of link at every name for resume, and some for the commands that read."""
    listed = []
    for number, name in enumerate(NAMES):
        for kind, make in KINDS.items():
            commands = (
                COMMANDS if number in (0, 2, 4) and kind in ("link to a file", "loop", "named pipe") else ("resume",)
            )
            listed += [
                Case(f"{command}: {name}: {kind}", EXPECTED, functools.partial(attack, command, name, make))
                for command in commands
            ]
    through = ("out/tabletop_organization", "out/tabletop_organization/naive")
    listed += [
        Case(f"sweep through {name}", "nothing outside is written", functools.partial(sweep_through, name))
        for name in through
    ]
    return listed
