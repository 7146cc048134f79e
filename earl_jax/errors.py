"""The error that means invalid input, as opposed to an error in the code of a task, of a method or of this package."""

import importlib
import inspect
import itertools
import re
import reprlib
import shlex
import sysconfig
import traceback
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from typing_extensions import Format, get_annotations

PACKAGE = Path(__file__).parent
SIMILAR = 0.82
"""The ratio of difflib from which a name of a member counts as a misspelling of another."""
LIBRARIES = [Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "purelib", "platlib")]


class InputError(ValueError):
    """Invalid input: a command prints its message as one line. Other errors keep their traceback."""


def install_line(extra: str) -> str:
    """Return the command that installs the libraries of an extra, whether the package comes from a checkout or a wheel."""
    from importlib import metadata

    try:
        required = metadata.requires("earl-jax") or []
    except metadata.PackageNotFoundError:  # only its folder is on the path
        return f"pip install -e {shlex.quote(f'{PACKAGE.parent}[{extra}]')}"
    own = [text for text in required if re.search(rf"extra == ['\"]{extra}['\"]", text)]
    return f"pip install {' '.join(shlex.quote(text.partition(';')[0].strip()) for text in own)}"


def optional(module: str, need: str, extra: str) -> Any:
    """Return a `module` of an optional library.

    Raises:
        InputError: it is not installed; the message is the `need`, the library and the line that installs the `extra`.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"{need} {module.partition('.')[0]}: {install_line(extra)}") from error


def choices(name: Any, names: Iterable[str]) -> str:
    """Return `names` for the message about an unknown `name`, after the one that it resembles most, if any does."""
    text, names = str(name).lower(), list(names)
    near = get_close_matches(text, names, 1) or [known for known in names if len(text) > 2 and text in known]
    return f"did you mean {near[0]!r}? Choose from {', '.join(names)}" if near else f"choose from {', '.join(names)}"


def check_overrides(cls: type) -> None:
    """Raise an InputError if a member of `cls` is meant to override another and does not, or not as its callers expect.

    That is a public member, no option, that is nearly called as one that it could override, or a method that overrides one
    of this package and takes other arguments, or another order.
    """
    own = vars(cls)
    inherited = {name for base in cls.__mro__[1:] for name in (*vars(base), *annotations(base))}
    options = {name for name, kind in annotations(cls).items() if "ClassVar" not in str(kind)}
    known = [name for name in inherited - own.keys() if not name.startswith("_")]
    for name in sorted(own.keys() - inherited - options):
        if not name.startswith("_") and (near := get_close_matches(name, known, 1, SIMILAR)):
            remedy = f"did you mean {near[0]!r}? If not, choose a name that is less like it"
            raise InputError(f"{cls.__name__}.{name} overrides nothing; {remedy}")
    for name, own in vars(cls).items():
        known = [vars(base).get(name) for base in cls.__mro__[1:] if base.__module__.startswith(f"{PACKAGE.name}.")]
        overridden: list[Any] = [value for value in known if _is_method(value)]
        if name.startswith("_") or not overridden or not _is_method(own):
            continue
        expected, given = (inspect.signature(function).parameters for function in (overridden[-1], own))
        takes_any = any(parameter.kind is inspect.Parameter.VAR_POSITIONAL for parameter in given.values())
        needed = [text for text, value in given.items() if text in expected or value.default is inspect.Parameter.empty]
        moved = any(text in expected and text != wanted for text, wanted in zip(needed, expected, strict=False))
        if not takes_any and (moved or len(needed) != len(expected)):
            raise InputError(f"{cls.__name__}.{name} must take ({', '.join(expected)}), not ({', '.join(given)})")


def annotations(cls: type) -> dict[str, Any]:
    """Return the annotations of the class itself, where a name that is unknown is left as it is written."""
    return get_annotations(cls, format=Format.FORWARDREF)


def _is_method(value: Any) -> bool:
    return callable(value) and not isinstance(value, type | staticmethod | classmethod)


def require_known(kind: str, name: Any, names: Collection[str]) -> None:
    """Raise an InputError with the `names` to choose from if `name` is none of them; `kind` says what they name."""
    if not isinstance(name, str) or name not in names:
        raise InputError(f"unknown {kind} {brief(name)}; {choices(name, names)}")


def brief(value: Any) -> str:
    """Return `value` as text of at most some hundred characters, for a message."""
    try:
        return " ".join(reprlib.repr(value.tolist() if hasattr(value, "tolist") else value).splitlines())
    except ValueError:  # Python writes no numbers of thousands of digits
        return "a number of thousands of digits"


def printable(text: str) -> str:
    """Return `text` with escapes in the place of letters that cannot be printed, which would break a line or hide text."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def is_input_error(error: BaseException) -> bool:
    """Return whether the message of `error` says all: invalid input, or a file that cannot be read or written.

    An OSError that passes through code from outside this package and the installed ones comes from the code of a task
    or a method, and is not one.
    """
    if not isinstance(error, OSError):
        return isinstance(error, InputError)
    paths = [Path(frame.filename) for frame in traceback.extract_tb(error.__traceback__)]
    below_package = itertools.dropwhile(lambda path: not path.is_relative_to(PACKAGE), paths)
    files = [path.resolve() for path in below_package if path.is_file()]
    return all(any(file.is_relative_to(root) for root in (PACKAGE, *LIBRARIES)) for file in files)
