"""The cache of compiled programs: cold, damaged, killed in a write, not writable."""

import functools
import os
import signal
from collections.abc import Callable
from pathlib import Path

from benchmarks.attacks.case import Case, Failure, Outcome, require
from benchmarks.attacks.checkpoints import CHANGES
from benchmarks.attacks.place import Place, train
from benchmarks.attacks.process import forked
from earl_jax.training import program_cache

EXPECTED = "the right results (of training: the identical table); damaged entries are compiled and stored anew, without a warning"
MAY_WARN = "the right results, with or without a warning"
RESULT = "7.0 3.0\n"


def use(cache: Path) -> None:
    """Let this process use the programs in `cache`, every program."""
    import jax

    os.environ[program_cache.VARIABLE] = str(cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    program_cache.keep_programs()


def compute() -> None:
    """Compile two programs and print their results."""
    import jax

    print(jax.jit(lambda x: 2 * x + 1)(3.0), jax.jit(lambda x: x @ x)(jax.numpy.eye(3)).sum())


def compiled(place: Place, cache: Path, before: Callable[[], object] | None = None) -> Outcome:
    """Return the outcome of a process that compiles with the programs in `cache`."""

    def action() -> None:
        use(cache)
        if before is not None:
            before()
        compute()

    return place.note(forked(action, place.path).wait())


def filled(place: Place) -> Path:
    """Return a new cache of small programs."""
    cache = place.path / "cache"
    require(compiled(place, cache).out == RESULT, place.outcomes[-1], "the result")
    if not any(cache.iterdir()):
        raise Failure("nothing was stored")
    return cache


def right(place: Place, cache: Path, warns: bool = False) -> str:
    """Compile with the programs in `cache` and expect the right results."""
    outcome = compiled(place, cache)
    require(outcome.code == 0 and outcome.out == RESULT, outcome, "the right results")
    require(warns or not outcome.err, outcome, "no warning")
    return "the right results"


def trained(place: Place, cache: Path) -> str:
    """Train with the programs in `cache` and expect the identical table and no warning."""
    outcome = place.run(*train("run"), before=functools.partial(use, cache), seconds=200)
    require("ache" not in outcome.err, outcome, "no warning about the cache")
    return place.identical(outcome, place.path / "run")


def cold_and_damaged(place: Place) -> str:
    """Train with a cold cache, damage every program, and train again."""
    cache = place.path / "cache"
    trained(place, cache)
    (place.path / "run").rename(place.path / "first")
    for path in cache.iterdir():
        path.write_bytes(path.read_bytes()[:-100])
    return trained(place, cache)


def damage(change: Callable[[Path], object], place: Place) -> str:
    """Damage every entry of a cache."""
    cache = filled(place)
    entries = {path: path.read_bytes() for path in cache.iterdir()}
    for path in entries:
        change(path)
    how = right(place, cache)
    missing = [path.name for path in entries if not path.exists() or path.stat().st_size < len(entries[path]) // 2]
    if missing:
        raise Failure(f"not stored anew: {missing[0]}")
    return how


def folders(place: Place) -> str:
    """Put folders in the place of entries."""
    cache = filled(place)
    for path in list(cache.iterdir()):
        path.unlink()
        path.mkdir()
    return right(place, cache, warns=True)


def kill(number: int, place: Place) -> str:
    """Kill a process in its n-th write of an entry, after half of it."""
    cache = place.path / "cache"

    def before() -> None:
        put, count = program_cache.CheckedCache.put, [0]

        def put_half(self, key: str, value: bytes) -> None:
            count[0] += 1
            if count[0] == number:
                (cache / f"{key}-cache").write_bytes(value[: len(value) // 2])
                os.kill(os.getpid(), signal.SIGKILL)
            put(self, key, value)

        program_cache.CheckedCache.put = put_half

    outcome = compiled(place, cache, before)
    require(outcome.code == -signal.SIGKILL, outcome, "the kill")
    return right(place, cache)


def unusable(make: Callable[[Path], object], place: Place) -> str:
    """Train with a cache folder that cannot be used."""
    cache = place.path / "cache"
    make(cache)
    return right(place, cache, warns=True)


def together(place: Place) -> str:
    """Let four processes fill one cache at the same time."""
    cache = place.path / "cache"
    running = [forked(lambda: (use(cache), compute()), place.path) for _ in range(4)]
    for process in running:
        outcome = place.note(process.wait())
        require(outcome.code == 0 and outcome.out == RESULT, outcome, "the right results")
    return right(place, cache)


def cases() -> list[Case]:
    """Return damages of all entries, kills in writes, and folders that cannot be used."""
    damages = {**{name: change for name, change in CHANGES.items() if name != "missing"}}
    damages["garbage"] = lambda path: path.write_bytes(os.urandom(5000))
    unusables: dict[str, Callable[[Path], object]] = {
        "a file in its place": lambda path: path.write_text("x"),
        "a loop in its place": lambda path: path.symlink_to(path.name),
        "a missing target": lambda path: path.symlink_to("nowhere/deep"),
    }
    return [
        *(
            Case(f"every entry: {name}", EXPECTED, functools.partial(damage, change))
            for name, change in damages.items()
        ),
        *(Case(f"killed in write {number}", EXPECTED, functools.partial(kill, number)) for number in (1, 2, 3)),
        *(Case(f"the folder: {name}", MAY_WARN, functools.partial(unusable, make)) for name, make in unusables.items()),
        Case("a folder in the place of every entry", MAY_WARN, folders),
        Case("four processes fill it", EXPECTED, together),
        Case("a training run with a cold and a damaged cache", EXPECTED, cold_and_damaged),
    ]
