"""Files that `import-demos` reads from strangers: pickles and npz files."""

import functools
import pickle

import numpy as np

from benchmarks.attacks.case import Case, Failure, refused, require
from benchmarks.attacks.place import Place
from tests.demos.test_importer import HOSTILE as ATTACKS

SECONDS, MEMORY_MB = 30.0, 1500.0
NAMES = ("observations", "actions", "rewards", "next_observations", "terminals")
EXPECTED = "one line, exit code 2, no npz, no memory or command of ours used, within 30 s and 1.5 GB"


def valid() -> bytes:
    """Return a recording as the original benchmark has it."""
    sizes = {"observations": 12, "actions": 3, "next_observations": 12}
    arrays = {name: np.zeros((20, size), np.float32) for name, size in sizes.items()}
    ends = {"rewards": np.zeros(20), "terminals": np.arange(20) % 10 == 9}
    return pickle.dumps({name: {**arrays, **ends}[name] for name in NAMES})


def truncated(part: int) -> bytes:
    """Return the first `part` tenths of a valid recording."""
    content = valid()
    return content[: len(content) * part // 10]


def flipped(part: int) -> bytes:
    """Return a valid recording with a bit flipped in the opcodes, after `part` hundredths of the first 400 bytes."""
    content = bytearray(valid())
    content[4 * part] ^= 1 << part % 8
    return bytes(content)


def import_file(place: Place, content: bytes, suffix: str):
    """Return the outcome of `import-demos` of `content`, and the paths of the file and of its output."""
    source, out = place.path / f"attack{suffix}", place.path / "out.npz"
    source.write_bytes(content)
    return place.run("import-demos", source, "--out", out, seconds=SECONDS, memory_mb=MEMORY_MB), out


def refuse(make, suffix: str, place: Place) -> str:
    """Import an attack and expect one line and no output."""
    outcome, out = import_file(place, make(), suffix)
    how = refused(outcome)
    if out.exists():
        raise Failure("an output was written")
    return how


def refuse_or_read(make, place: Place) -> str:
    """Import a file that may still be a recording, with other numbers in it."""
    outcome, out = import_file(place, make(), ".pkl")
    if outcome.code == 0:
        with np.load(out, allow_pickle=False) as arrays:
            require(all(np.isfinite(arrays[name]).all() for name in arrays), outcome, "finite arrays")
        return "read as the arrays that it holds"
    return refused(outcome)


def cases() -> list[Case]:
    """Return an import for every attack file, and for damaged versions of a valid one."""
    hostile = [
        Case(name, EXPECTED, functools.partial(refuse, make, ".npz" if name.startswith("npz") else ".pkl"))
        for name, make in ATTACKS.items()
    ]
    cut = [
        Case(
            f"pickle cut after {part} tenths",
            EXPECTED,
            functools.partial(refuse, functools.partial(truncated, part), ".pkl"),
        )
        for part in range(10)
    ]
    flips = [
        Case(
            f"pickle with a flipped bit in byte {4 * part}", f"read as the arrays that it holds, or: {EXPECTED}",
            functools.partial(refuse_or_read, functools.partial(flipped, part)),
        )
        for part in range(0, 100, 5)
    ]  # fmt: skip
    return hostile + cut + flips
