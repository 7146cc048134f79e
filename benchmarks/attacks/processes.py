"""Two processes that use one folder at once."""

import functools
import shutil
import signal
import time

from benchmarks.attacks.case import Case, Failure, describe, refused, require
from benchmarks.attacks.place import Place, train
from earl_jax.runs.files import locked

EXPECTED = "one succeeds with the identical table, the other gets one line that names the other process or run"
READS = "an output or one line; the training goes on to the identical table"
WORDS = ("another process", "another run")


def both(command: str, delay: float, place: Place) -> str:
    """Start the same command twice, the second one `delay` seconds later."""
    folder = place.unfinished() if command == "resume" else place.path / "run"
    arguments = ("resume", folder) if command == "resume" else train(folder)
    running = [place.start(*arguments)]
    time.sleep(delay)
    running.append(place.start(*arguments))
    outcomes = [place.note(process.wait()) for process in running]
    codes = sorted(outcome.code for outcome in outcomes)
    if codes == [0, 0] and command == "resume":  # the second one began after the first one had ended
        return place.identical(outcomes[1], folder)
    if codes != [0, 2]:
        raise Failure(" and ".join(map(describe, outcomes)))
    second = next(outcome for outcome in outcomes if outcome.code == 2)
    refused(second)
    require(any(word in second.err for word in WORDS), second, "the cause")
    place.identical(next(outcome for outcome in outcomes if outcome.code == 0), folder)
    return "one finished, one refused in one line"


def while_locked(arguments: tuple[str, ...], allowed: bool, place: Place) -> str:
    """Run a command on a folder that this process has locked."""
    folder = place.unfinished()
    with locked(folder):
        outcome = place.run(*arguments)
    if allowed:
        require(outcome.code == 0, outcome, "the output")
        return "read"
    require(any(word in outcome.err for word in WORDS), outcome, "the cause")
    return refused(outcome)


def read_in_training(command: str, place: Place) -> str:
    """Repeat a command that reads while the run trains."""
    folder = place.path / "run"
    running = place.start(*train(folder))
    deadline = time.monotonic() + 60
    while not (folder / "metrics.csv").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    for number in range(3):
        outcome = place.run(
            command,
            folder,
            *(
                ()
                if command in ("evaluate", "table")
                else ("--out", f"{number}.html" if command == "report" else f"{number}.png")
            ),
        )
        if outcome.code:
            refused(outcome)
    return place.identical(place.note(running.wait()), folder)


def moved(place: Place) -> str:
    """Move the folder away from a run that trains."""
    folder = place.path / "run"
    running = place.start(*train(folder))
    while not (folder / "metrics.csv").exists():
        time.sleep(0.01)
    folder.rename(place.path / "moved")
    outcome = place.note(running.wait())
    require("Traceback" not in outcome.err and outcome.code in (0, 2), outcome, "one line or the end")
    return place.resumed(place.path / "moved")


def removed(place: Place) -> str:
    """Remove the folder of a run that trains."""
    folder = place.path / "run"
    running = place.start(*train(folder))
    while not (folder / "metrics.csv").exists():
        time.sleep(0.01)
    shutil.rmtree(folder, ignore_errors=True)
    outcome = place.note(running.wait())
    require("Traceback" not in outcome.err and outcome.code in (0, 2), outcome, "one line or the end")
    return "stopped with one line" if outcome.code else "went on"


def stopped(place: Place) -> str:
    """Stop a run by SIGSTOP for a second and let it go on."""
    folder = place.path / "run"
    running = place.start(*train(folder))
    time.sleep(2.0)
    running.send(signal.SIGSTOP)
    time.sleep(1.0)
    running.send(signal.SIGCONT)
    return place.identical(place.note(running.wait()), folder)


def cases() -> list[Case]:
    """Return commands twice at once, on a locked folder, and beside a run that trains."""
    locks = {
        ("resume", "run"): False, ("resume", "run", "--steps", "240"): False, ("evaluate", "run", "--episodes", "1"): True,
        ("table", "run"): True, ("plot", "run", "--out", "x.png"): True, ("report", "run", "--out", "x.html"): True,
        tuple(train("run")): False, (*train("run")[:4], "--out", "run", "--overwrite", "--steps", "120"): False,
    }  # fmt: skip
    return [
        *(
            Case(f"{command} twice, {delay} s apart", EXPECTED, functools.partial(both, command, delay))
            for command in ("train", "resume")
            for delay in (0.0, 0.5, 2.0)
        ),
        *(
            Case(f"{' '.join(arguments[:3])} on a locked folder{' with --overwrite' * ('--overwrite' in arguments)}",
                 "the output" if allowed else "one line", functools.partial(while_locked, arguments, allowed))
            for arguments, allowed in locks.items()
        ),
        *(Case(f"{command} while it trains", READS, functools.partial(read_in_training, command))
          for command in ("evaluate", "table", "plot", "report")),
        Case("the folder is moved while it trains", "one line; the moved folder resumes to the identical table", moved),
        Case("the folder is removed while it trains", "one line, no traceback", removed),
        Case("SIGSTOP for a second", "the identical table", stopped),
    ]  # fmt: skip
