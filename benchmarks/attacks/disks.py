"""Full disks, failing disks, read-only folders, file systems without locks or with stale handles."""

import errno
import functools
import resource
import shutil
import subprocess

from benchmarks.attacks import events
from benchmarks.attacks.case import Case, Failure, refused, require
from benchmarks.attacks.place import Place, train
from benchmarks.attacks.process import limited
from benchmarks.attacks.signals import continued

EXPECTED = "one error line, exit code 2, no traceback; then it continues with the identical table. Or the identical table at once"
CODES = (errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.ESTALE, errno.EROFS, errno.EACCES)
SIZES = (1000, 2000, 5_000, 20_000, 60_000, 200_000)  # the error line needs room as well
LOCKS = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL, errno.EIO)
UNLOCKED = "one warning and the identical table; EIO and EINVAL may stop with one line"
CHANGES = tuple(range(1, 61, 3))


def stopped(outcome) -> None:
    """Expect that an error line ends the command, after lines of progress."""
    lines = outcome.err.strip().splitlines() or [""]
    errors = [line for line in lines if line.startswith("earl-jax: ")]
    require(outcome.code == 2 and "Traceback" not in outcome.err and errors, outcome, "one error line, exit code 2")


def train_with(before, place: Place) -> str:
    """Train on a disk that fails, then continue on a sound one."""
    folder = place.path / "run"
    outcome = place.run(*train(folder), before=before(folder))
    if outcome.code == 0:
        return place.identical(outcome, folder)
    stopped(outcome)
    continued(place, folder)
    return "stopped with one line, continued with the identical table"


def resume_with(before, place: Place) -> str:
    """Resume on a disk that fails, then on a sound one."""
    folder = place.unfinished()
    outcome = place.run("resume", folder, before=before(folder))
    if outcome.code == 0:
        return place.identical(outcome, folder)
    stopped(outcome)
    place.resumed(folder)
    return "stopped with one line, continued with the identical table"


def failing(number: int, code: int, times: int = 1):
    """Return what lets `times` changes of a folder fail from the n-th on."""
    return lambda folder: events.fail_at(number, code, folder, times)


def full(size: int):
    """Return what limits files to `size` bytes."""
    return lambda folder: limited(resource.RLIMIT_FSIZE, size)


def few_files(number: int):
    """Return what limits open files."""
    return lambda folder: limited(resource.RLIMIT_NOFILE, number)


def unlocked(code: int, place: Place) -> str:
    """Train where locking fails: go on with a warning where there are no locks, stop where they fail otherwise."""
    folder = place.path / "run"
    outcome = place.run(*train(folder), before=events.without_locks(code))
    if outcome.code == 0:
        lines = [line for line in outcome.err.splitlines() if "lock" in line.lower()]
        require(len(lines) == 1, outcome, "one warning about locks")
        place.identical(outcome, folder)
        return "went on with one warning"
    if code in (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK):
        require(False, outcome, "one warning, and the identical table")
    return refused(outcome)


def read_only(command: str, place: Place) -> str:
    """Use a run on a disk that is mounted read-only."""
    disk = place.path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(disk)], capture_output=True).returncode:
        return "not tried: a disk cannot be mounted here"
    try:
        shutil.move(place.unfinished(), disk / "run")
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        arguments = {
            "resume": ("resume", disk / "run"), "train": train(disk / "new"), "table": ("table", disk / "run"),
            "evaluate": ("evaluate", disk / "run", "--episodes", "1"), "plot": ("plot", disk / "run", "--out", disk / "x.png"),
            "report": ("report", disk / "run", "--out", disk / "x.html"),
            "resume longer": ("resume", disk / "run", "--steps", "240"),
            "table written": ("table", disk / "run", "--out", disk / "x.md"),
            "sweep": ("reproduce", "table1", "--out", disk / "sweep"),
        }[command]  # fmt: skip
        outcome = place.run(*arguments)
        if command in ("table", "evaluate"):
            require(outcome.code == 0 and not outcome.err, outcome, "the numbers")
            return "read"
        return refused(outcome)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def exclusive(place: Place) -> str:
    """Train where exclusive creation (O_EXCL) and renames of files in use act as on NFS: a stale handle at each 5th change."""
    folder = place.path / "run"

    def before() -> None:
        def act(count: int) -> None:
            if count % 5 == 0:
                raise OSError(errno.ESTALE, "Stale file handle")

        events.watch(folder, events.unlisted(act))

    outcome = place.run(*train(folder), before=before)
    if outcome.code == 0:
        return place.identical(outcome, folder)
    stopped(outcome)
    shutil.rmtree(folder, ignore_errors=True)
    if folder.exists():
        raise Failure("the folder cannot be removed")
    return "stopped with one line"


def cases() -> list[Case]:
    """Return failing changes, limits of size, folders without locks and read-only disks."""
    one = [
        Case(
            f"{errno.errorcode[code]} at change {number} of the folder",
            EXPECTED,
            functools.partial(train_with, failing(number, code)),
        )
        for position, number in enumerate(CHANGES)
        for code in (CODES[position % len(CODES)],)
    ]
    rest = [
        Case(f"{errno.errorcode[code]} at every change from {number} on", EXPECTED,
             functools.partial(resume_with, failing(number, code, times=10**6)))
        for number in (1, 4, 8, 12)
        for code in (errno.ENOSPC, errno.ESTALE)
    ]  # fmt: skip
    sizes = [
        Case(f"files of at most {size} bytes: {name}", EXPECTED, functools.partial(act, full(size)))
        for size in SIZES
        for name, act in (("train", train_with), ("resume", resume_with))
    ]
    files = [
        Case(f"{number} open files", EXPECTED, functools.partial(train_with, few_files(number))) for number in (24, 40)
    ]
    locks = [
        Case(f"{errno.errorcode[code]} from every lock", UNLOCKED,
             functools.partial(unlocked, code))
        for code in LOCKS
    ]  # fmt: skip
    commands = ("resume", "resume longer", "train", "table", "table written", "evaluate", "plot", "report", "sweep")
    mounted = [
        Case(
            f"read-only disk: {command}",
            "one line; commands that only read work",
            functools.partial(read_only, command),
        )
        for command in commands
    ]
    stale = Case("stale handles at every fifth change, as on NFS", EXPECTED, exclusive)
    return [*one, *rest, *sizes, *files, *locks, *mounted, stale]
