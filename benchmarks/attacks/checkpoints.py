"""Damaged checkpoints, manifests, replay files and policies."""

import functools
import json
import shutil
from collections.abc import Callable
from pathlib import Path

from benchmarks.attacks.case import Case, Failure, first, refused, require, unchanged
from benchmarks.attacks.place import EVERY, STEPS, Place
from earl_jax.errors import InputError
from earl_jax.runs.checkpoint import verified

NEWEST, OLDER = f"checkpoints/{STEPS:09d}", f"checkpoints/{STEPS - EVERY:09d}"
FALLS_BACK = "a warning, training from the older checkpoint, the identical table"
REFUSES = "one line, exit code 2, nothing changed"
Damage = Callable[[Path], object]
INSIDE = ("_METADATA", "manifest.ocdbt", "d", "ocdbt.process_0", "_CHECKPOINT_METADATA")
PARTS = ("manifest.json", *(f"{tree}/{name}" for tree in ("lanes", "replay") for name in INSIDE))
"""Files, or folders of which the largest file is meant."""


def target(path: Path) -> Path:
    """Return `path`, or the largest file in it."""
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    return max(files, key=lambda file: (file.stat().st_size, str(file)))


def flip(share: float, path: Path) -> None:
    """Flip one bit at `share` of the length."""
    content = bytearray(path.read_bytes())
    place = min(int(share * len(content)), len(content) - 1)
    content[place] ^= 1 << place % 8
    path.write_bytes(bytes(content))


def cut(path: Path) -> None:
    """Truncate a file by seven bytes, or to nothing."""
    path.write_bytes(path.read_bytes()[:-7])


def empty(path: Path) -> None:
    """Leave an empty file."""
    path.write_bytes(b"")


def grow(path: Path) -> None:
    """Append a byte."""
    path.write_bytes(path.read_bytes() + b"x")


CHANGES: dict[str, Damage] = {
    "first byte": functools.partial(flip, 0.0),
    "middle byte": functools.partial(flip, 0.5),
    "last byte": functools.partial(flip, 1.0),
    "truncated": cut,
    "empty": empty,
    "longer": grow,
    "missing": Path.unlink,
}


def manifest(change: Callable[[dict], object], path: Path) -> None:
    """Change the JSON of a manifest; `checksum` is kept."""
    values = json.loads(path.read_text())
    result = change(values)
    path.write_text(json.dumps(values if result is None else result))


MANIFESTS: dict[str, Callable[[dict], object]] = {
    "no step": lambda values: values.pop("step") and None,
    "no lanes": lambda values: values.pop("lanes") and None,
    "no files": lambda values: values.pop("files") and None,
    "no checksum": lambda values: values.pop("checksum") and None,
    "another step": lambda values: values.update(step=1),
    "a step of text": lambda values: values.update(step="x"),
    "files as a list": lambda values: values.update(files=[]),
    "a file outside": lambda values: values["files"].update({"../../../config.json": "x"}),
    "an absolute file": lambda values: values["files"].update({"/etc/passwd": "x"}),
    "a list": lambda values: [values],
    "null": lambda values: "null",
}


def resume(damage: Damage, fallback: bool, place: Place) -> str:
    """Damage the finished run and resume it."""
    folder = place.finished()
    damage(folder)
    if fallback:
        outcome = place.run("resume", folder)
        require("damaged" in outcome.err or outcome.code, outcome, "a warning that names the damage")
        return place.identical(outcome, folder)
    with unchanged(folder):
        return refused(place.run("resume", folder))


def evaluate(damage: Damage, place: Place) -> str:
    """Damage the finished run and evaluate it."""
    folder = place.finished()
    sound = place.run("evaluate", folder, "--episodes", "2", "--json")
    damage(folder)
    with unchanged(folder):
        outcome = place.run("evaluate", folder, "--episodes", "2", "--json")
    if outcome.code == 0:
        require(outcome.out == sound.out, outcome, "the same scores")
        return "evaluated with the same scores"
    return refused(outcome)


def at(name: str, change: Damage, folder: Path) -> None:
    """Apply `change` to a file of a run folder."""
    change(target(folder / name))


def both(name: str, change: Damage, folder: Path) -> None:
    """Apply `change` to a file in both checkpoints."""
    for checkpoint in (NEWEST, OLDER):
        change(target(folder / checkpoint / name))


def swap(name: str, folder: Path) -> None:
    """Put a part of the older checkpoint in the newest one."""
    source, place = folder / OLDER / name, folder / NEWEST / name
    if source.is_dir():
        shutil.rmtree(place)
        shutil.copytree(source, place)
    else:
        shutil.copy(source, place)


def rename(name: str, folder: Path) -> None:
    """Give the newest checkpoint another name."""
    (folder / NEWEST).rename(folder / "checkpoints" / name)


def add(name: str, folder: Path) -> None:
    """Add an empty folder among the checkpoints."""
    (folder / "checkpoints" / name).mkdir()


def remove_newest(folder: Path) -> None:
    """Remove the newest checkpoint of a finished run."""
    shutil.rmtree(folder / NEWEST)


def flip_everywhere(place: Place) -> str:
    """Flip a bit at several places of every file, one at a time, and expect that the check of the checkpoint finds each."""
    checkpoint, count = place.finished() / NEWEST, 0
    for path in sorted(path for path in checkpoint.rglob("*") if path.is_file()):
        content = path.read_bytes()
        for share in (0.0, 0.01, 0.25, 0.5, 0.75, 0.99, 1.0) if content else ():
            flip(share, path)
            try:
                verified(checkpoint)
            except InputError as error:
                if str(checkpoint) not in str(error):
                    raise Failure(f"the message does not name the checkpoint: {error}") from None
            else:
                raise Failure(f"{path.relative_to(checkpoint)} with a flipped bit at {share} passes the check")
            path.write_bytes(content)
            count += 1
    verified(checkpoint)
    return f"{count} flipped bits detected"


def resume_anyhow(damage: Damage, place: Place) -> str:
    """Expect one line with nothing changed, or the identical table."""
    folder = place.finished()
    damage(folder)
    outcome = place.run("resume", folder)
    return first(lambda: place.identical(outcome, folder), lambda: refused(outcome))


def cases() -> list[Case]:
    """Return damages of one checkpoint, of both, of manifests and of policies."""
    one = [
        Case(
            f"newest: {part}: {name}",
            FALLS_BACK,
            functools.partial(resume, functools.partial(at, f"{NEWEST}/{part}", change), True),
        )
        for part in PARTS
        for name, change in CHANGES.items()
    ]
    two = [
        Case(
            f"both: {part}: {name}", REFUSES, functools.partial(resume, functools.partial(both, part, change), False),
            fast=part == "manifest.json" and name in ("middle byte", "missing"),
        )
        for part in ("manifest.json", "lanes/d", "replay/d")
        for name, change in CHANGES.items()
    ]  # fmt: skip
    listed = [
        Case(
            f"both manifests: {name}", REFUSES,
            functools.partial(resume, functools.partial(both, "manifest.json", functools.partial(manifest, change)), False),
            fast=True,
        )
        for name, change in MANIFESTS.items()
    ]  # fmt: skip
    swaps = [
        Case(
            f"newest with the {name} of the older one",
            FALLS_BACK,
            functools.partial(resume, functools.partial(swap, name), True),
        )
        for name in ("manifest.json", "lanes", "replay")
    ]
    names = [
        Case(
            f"{kind} named {name!a}",
            "the identical table, or one line",
            functools.partial(resume_anyhow, functools.partial(act, name)),
        )
        for kind, act, texts in (
            ("newest checkpoint", rename, ("120", "²", "000000999", "x", "part-120", "-1", "9" * 100)),
            ("an empty folder", add, ("²", "000000999", "٣", "part-1", "9" * 100, ".x", "000000120x")),
        )
        for name in texts
    ]
    policies = [
        Case(
            f"policies.npz: {name}",
            "the scores as before, or one line",
            functools.partial(evaluate, functools.partial(at, "policies.npz", change)),
        )
        for name, change in CHANGES.items()
    ]
    flips = Case(
        "a bit at seven places of every file", "each is detected, and the message names it", flip_everywhere, fast=True
    )
    gone = Case(
        "a finished run without its newest checkpoint",
        "the identical table, or one line",
        functools.partial(resume_anyhow, remove_newest),
    )
    return [*one, *two, *listed, *swaps, *names, *policies, flips, gone]
