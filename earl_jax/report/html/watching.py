"""A page that follows runs while they train."""

import datetime
import functools
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.report.html.policy_videos import PolicyVideos
from earl_jax.report.html.writing import require_writable, write_page
from earl_jax.report.runs import find_runs
from earl_jax.runs.contents import FILES

VIDEOS = (".mp4", ".gif")
LEAST_SECONDS = 1.0


def watch_page(
    folders: Sequence[Path],
    out: Path,
    every: float,
    emit: Callable[[str], None],
    sleep: Callable[[float], None] = time.sleep,
    policies: PolicyVideos | None = None,
) -> None:
    """Write the page of `folders` to `out` again whenever a run changes, looking `every` so many seconds, until Ctrl-C.

    The page reloads itself as often in a browser, and is never half written. After Ctrl-C it is written once more, without
    that. Before the first run can be read it waits. With `policies`, the page has videos of policies.

    Raises:
        ValueError: `every` is under a second, `out` is not an .html file, or a library is missing.
    """
    if not every >= LEAST_SECONDS:
        raise InputError(f"every must be at least {LEAST_SECONDS:g} second, not {every}")
    require_writable(out)
    write = functools.partial(write_page, folders, out, policies=policies)
    state: tuple[object, ...] | None = None
    cause = ""
    try:
        while True:
            before, state = state, tuple(_changes(folders))
            if state != before and state:
                cause = _write(write, out, every, emit, cause)
            elif not state and before is None:
                emit(f"waiting for runs in {', '.join(map(str, folders))}; Ctrl-C ends")
            sleep(every)
    except KeyboardInterrupt:
        if out.is_file() and state:
            write()
            emit(f"{out} is of {_now()} and does not reload any more")


def _write(write: Callable[..., Path], out: Path, every: float, emit: Callable[[str], None], earlier: str) -> str:
    """Call `write`, and return why the page could not be written, or an empty text. A cause other than `earlier` is emitted."""
    try:
        write(reload_seconds=every)
    except InputError as error:
        cause = str(error).splitlines()[-1].strip()
        if cause != earlier:
            emit(f"waiting: {cause}")
        return cause
    emit(f"{out}: written at {_now()}; Ctrl-C ends")
    return ""


def _runs(folders: Sequence[Path]) -> list[Path]:
    """Return the run folders in those of `folders` that exist already."""
    runs: list[Path] = []
    for folder in folders:
        try:
            runs += find_runs([folder])
        except InputError:
            continue
    return runs


def _changes(folders: Sequence[Path]) -> Iterator[tuple[str, int, int]]:
    """Yield path, size and time of each file that a page shows; a change of any means that the page is out of date."""
    for run in _runs(folders):
        videos = [path for path in sorted(run.iterdir()) if path.suffix in VIDEOS]
        for path in [*(run / name for name in FILES), *videos]:
            try:
                status = path.stat()
            except OSError:
                continue
            yield str(path), status.st_size, status.st_mtime_ns


def _now() -> str:
    return f"{datetime.datetime.now(datetime.UTC):%H:%M:%S} UTC"
