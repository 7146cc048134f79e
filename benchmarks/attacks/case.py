"""A case of the catalogue, what a command did, and the expectations that cases share."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

QUIET = (".lock",)
"""Files that a command may leave in any folder."""


class Failure(Exception):  # noqa: N818  (it is a verdict)
    """An attack that was not survived; the message says what was expected and what came."""


class Outcome(NamedTuple):
    """What one command did. `code` is minus the signal that ended it; `limit` names the bound that it passed, if any."""

    code: int
    out: str
    err: str
    seconds: float = 0.0
    peak_mb: float = 0.0
    limit: str = ""


@dataclasses.dataclass(frozen=True)
class Case:
    """One attack: a function of a `Place` that returns how it was survived, or raises a `Failure`.

    `fast` cases need no process of their own and no training, so they are also tests.
    """

    name: str
    expected: str
    attack: Callable[[Any], str]
    fast: bool = False


def describe(outcome: Outcome) -> str:
    """Return an outcome in one short line."""
    last = outcome.err.strip().splitlines()[-1:] or outcome.out.strip().splitlines()[-1:] or [""]
    code = outcome.limit or (f"signal {-outcome.code}" if outcome.code < 0 else f"exit code {outcome.code}")
    return f"{code}, {len(outcome.err.strip().splitlines())} lines on stderr, the last one: {last[0][:160]}"


def require(condition: object, outcome: Outcome, wanted: str) -> None:
    """Raise a `Failure` with what was `wanted` and what came, unless `condition` holds."""
    if outcome.limit:
        raise Failure(f"{outcome.limit}; wanted: {wanted}")
    if not condition:
        raise Failure(f"{describe(outcome)}; wanted: {wanted}")


def refused(outcome: Outcome, *words: str) -> str:
    """Expect exit code 2 and exactly one line on stderr, which contains all `words`."""
    lines = outcome.err.strip().splitlines()
    wanted = f"one line, exit code 2{''.join(f', {word!r}' for word in words)}"
    require(outcome.code == 2 and len(lines) == 1 and lines[0].startswith("earl-jax: "), outcome, wanted)
    require(all(word in lines[0] for word in words), outcome, wanted)
    require(len(lines[0]) < 2000, outcome, "a line of less than 2000 characters")
    return "refused in one line"


def refused_arguments(outcome: Outcome) -> str:
    """Expect exit code 2 and one line, or the usage that argument parsers print; never a traceback."""
    if "Traceback" not in outcome.err and any(word in outcome.err for word in ("usage:", "helptext")):
        require(outcome.code == 2, outcome, "exit code 2")
        return "refused with the usage"
    return refused(outcome)


def traceback_kept(outcome: Outcome, *words: str) -> str:
    """Expect exit code 1 and a traceback that contains all `words`."""
    kept = "Traceback" in outcome.err and all(word in outcome.err for word in words)
    require(outcome.code == 1 and kept, outcome, f"exit code 1 and a traceback with {', '.join(words)}")
    return "traceback kept"


def snapshot(folder: Path) -> dict[str, Any]:
    """Return every path below `folder` with its content: bytes, the target of a link, or its kind."""
    contents: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        if path.name in QUIET:
            continue
        name = str(path.relative_to(folder))
        if path.is_symlink():
            contents[name] = ("link", str(path.readlink()))
        else:
            contents[name] = path.read_bytes() if path.is_file() else ("folder" if path.is_dir() else "special")
    return contents


@contextlib.contextmanager
def unchanged(folder: Path) -> Iterator[None]:
    """Expect that the context leaves `folder` as it is, except for locks."""
    before = snapshot(folder)
    yield
    after = snapshot(folder)
    changed = [name for name in {**before, **after} if before.get(name) != after.get(name)]
    if changed:
        raise Failure(f"changed in {folder.name}: {', '.join(changed[:5])}")


def first(*attempts: Callable[[], str]) -> str:
    """Return what the first of `attempts` that holds returns; if none does, raise all their failures."""
    failures = []
    for attempt in attempts:
        try:
            return attempt()
        except Failure as failure:
            failures.append(str(failure))
    raise Failure(" | or: ".join(failures))
