"""A page that follows runs while they train."""

import datetime
import functools
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from earl_jax.errors import InputError
from earl_jax.report.html.media import KINDS
from earl_jax.report.html.policy_videos import PolicyVideos
from earl_jax.report.html.writing import require_writable, write_page
from earl_jax.report.runs import find_runs
from earl_jax.runs.contents import FILES

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
    shown, cause = None, ""
    try:
        while True:
            changes = set(_changes(folders))
            if shown is None and not changes:
                emit(f"waiting for runs in {', '.join(map(str, folders))}; Ctrl-C ends")
            if changes and changes != shown:
                try:
                    write(reload_seconds=every)
                    cause = ""
                    emit(f"{out}: written at {_now()}; Ctrl-C ends")
                except InputError as error:
                    earlier, cause = cause, str(error).splitlines()[-1].strip()
                    if cause != earlier:
                        emit(f"waiting: {cause}")
            shown = changes
            sleep(every)
    except KeyboardInterrupt:
        if out.is_file() and shown:
            write()
            emit(f"{out} is of {_now()} and does not reload any more")


def _changes(folders: Sequence[Path]) -> Iterator[tuple[Path, int, int]]:
    """Yield path, size and time of each file that a page shows; a change of any means that the page is out of date."""
    for folder in folders:
        try:
            runs = find_runs([folder])
        except InputError:  # no run is there yet
            continue
        for run in runs:
            videos = [path for path in run.iterdir() if path.suffix in KINDS]
            for path in [*(run / name for name in FILES), *videos]:
                if path.exists():
                    status = path.stat()
                    yield path, status.st_size, status.st_mtime_ns


def _now() -> str:
    return f"{datetime.datetime.now(datetime.UTC):%H:%M:%S} UTC"
