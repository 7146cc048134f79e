"""Runs cases, and shows first that it can report failures."""

import os
import shutil
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.attacks.case import Case, Failure, Outcome, refused, require, unchanged
from benchmarks.attacks.place import Place, train
from benchmarks.attacks.process import forked, preload

Row = dict[str, Any]
"""The result of a case: class, case, expected, verdict, how, seconds, peak_mb."""


def baseline(root: Path) -> Path:
    """Return the folder of the run `whole`, after training it below `root`; it compiles the programs of most cases."""
    place = Place(root / "training", root / "baseline")
    outcome = place.run(*train(root / "baseline" / "whole"), seconds=600)
    require(outcome.code == 0, outcome, "a finished run")
    return root / "baseline"


def run_case(kind: str, case: Case, place: Place) -> Row:
    """Return the result of one case; an error in its own code is a failure too."""
    began = time.monotonic()
    try:
        how = case.attack(place)
        place.check_outside()
        verdict = "survived"
    except Failure as failure:
        verdict, how = "failed", str(failure)
    except Exception as error:
        verdict, how = "failed", f"{type(error).__name__}: {error}"
    for folder in (place.path, place.outside):
        shutil.rmtree(folder, ignore_errors=True)
    peak = max((outcome.peak_mb for outcome in place.outcomes), default=0.0)
    row = {
        "class": kind,
        "case": case.name,
        "expected": case.expected,
        "verdict": verdict,
        "how": " ".join(how.split()),
    }
    return {**row, "seconds": round(time.monotonic() - began, 2), "peak_mb": peak}


def run_cases(
    selection: Sequence[tuple[str, Case]],
    root: Path,
    run: Callable[..., Outcome] | None = None,
    folder: Path | None = None,
) -> list[Row]:
    """Return the results of all cases; `folder` holds the baseline, and `run` runs a command instead of a new process."""
    if run is None:
        preload()
    trained = folder or baseline(root)
    rows = []
    for number, (kind, case) in enumerate(selection):
        rows.append(run_case(kind, case, Place(root / f"case{number}", trained, run)))
        print(f"{rows[-1]['verdict']:<9} {kind}: {case.name}: {rows[-1]['how'][:300]}", flush=True)
    return rows


def self_test(root: Path) -> None:
    """Raise a RuntimeError unless expectations that are wrong on purpose are reported as failed, each for its reason."""
    broken = {
        "a command that succeeds is not refused": (lambda place: refused(place.run("list")), "exit code 0"),
        "one line without its cause": (lambda place: refused(place.run("train", "nowhere"), "maze"), "'maze'"),
        "a folder that changes": (_change_a_folder, "changed in"),
        "a file outside that is written": (_write_outside, "outside the run folder"),
        "a process that hangs": (lambda place: _act(place, lambda: time.sleep(60), 1.0), "still running"),
        "a process that takes memory": (lambda place: _act(place, _fill), "took more than"),
        "a process that crashes": (
            lambda place: _act(place, lambda: os.kill(os.getpid(), signal.SIGSEGV)),
            "signal 11",
        ),
        "a case with an error": (lambda place: str(1 // 0), "ZeroDivisionError"),
    }
    for number, (name, (attack, reason)) in enumerate(broken.items()):
        row = run_case("self-test", Case(name, "to be reported as failed", attack), Place(root / f"self{number}", root))
        if row["verdict"] != "failed" or reason not in row["how"]:
            raise RuntimeError(f"self-test: {name} was reported as {row['verdict']}: {row['how']}")


def _act(place: Place, action: Callable[[], object], seconds: float = 60.0) -> str:
    outcome = place.note(forked(action, place.path).wait(seconds, memory_mb=800.0))
    require(outcome.code == 0, outcome, "exit code 0")
    return "survived"


def _fill() -> None:
    filler = b"x" * (1 << 30)
    time.sleep(60 if filler else 0)


def _change_a_folder(place: Place) -> str:
    with unchanged(place.path):
        (place.path / "new.txt").write_text("new")
    return "survived"


def _write_outside(place: Place) -> str:
    (place.outside / "secret.txt").write_text("")
    return "survived"
