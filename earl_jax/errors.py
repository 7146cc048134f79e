"""The error for invalid input, as opposed to errors in the code of a task, a method or this package."""

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
"""The ratio of difflib from which the name of a member counts as a misspelling of another."""
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
        InputError: the library is not installed; the message gives the `need`, the library and how to install `extra`.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"{need} {module.partition('.')[0]}: {install_line(extra)}") from error


def choices(name: Any, names: Iterable[str]) -> str:
    """Return `names` for the message about an unknown `name`, with the most similar one first if there is one."""
    text, names = str(name).lower(), list(names)
    near = get_close_matches(text, names, 1) or [known for known in names if len(text) > 2 and text in known]
    return f"did you mean {near[0]!r}? Choose from {', '.join(names)}" if near else f"choose from {', '.join(names)}"


def check_overrides(cls: type) -> None:
    """Raise an InputError if a member of `cls` seems meant to override another but does not, or has other arguments.

    This applies to a public member (not an option) whose name nearly equals one that it could override, and to a method
    that overrides a method of this package with other arguments or in another order.
    """
    own = vars(cls)
    inherited = {name for base in cls.__mro__[1:] for name in (*vars(base), *annotations(base))}
    known = [name for name in inherited - own.keys() if not name.startswith("_")]
    for name in sorted(own.keys() - inherited - own_options(cls)):
        if not name.startswith("_") and (near := get_close_matches(name, known, 1, SIMILAR)):
            remedy = f"did you mean {near[0]!r}? If not, choose a name that is less like it"
            raise InputError(f"{cls.__name__}.{name} overrides nothing; {remedy}")
    for name, own in vars(cls).items():
        known = [vars(base).get(name) for base in cls.__mro__[1:] if is_of_package(base)]
        overridden: list[Any] = [value for value in known if _is_method(value)]
        if name.startswith("_") or not overridden or not _is_method(own):
            continue
        expected, given = (inspect.signature(function).parameters for function in (overridden[-1], own))
        takes_any = any(parameter.kind is inspect.Parameter.VAR_POSITIONAL for parameter in given.values())
        needed = [text for text, value in given.items() if text in expected or value.default is inspect.Parameter.empty]
        moved = any(text in expected and text != wanted for text, wanted in zip(needed, expected, strict=False))
        if not takes_any and (moved or len(needed) != len(expected)):
            raise InputError(f"{cls.__name__}.{name} must take ({', '.join(expected)}), not ({', '.join(given)})")


def is_of_package(cls: type) -> bool:
    """Return whether a module of this package defines the class."""
    return cls.__module__.startswith(f"{PACKAGE.name}.")


def own_options(cls: type) -> set[str]:
    """Return the names that the class itself annotates as options, which are its fields if it is decorated as a dataclass."""
    return {name for name, kind in annotations(cls).items() if "ClassVar" not in str(kind)}


def annotations(cls: type) -> dict[str, Any]:
    """Return the annotations of the class itself; unknown names in them stay as text."""
    return get_annotations(cls, format=Format.FORWARDREF)


def _is_method(value: Any) -> bool:
    return callable(value) and not isinstance(value, type | staticmethod | classmethod)


def require_known(kind: str, name: Any, names: Collection[str]) -> None:
    """Raise an InputError that lists `names` if `name` is not among them; `kind` says what they name."""
    if not isinstance(name, str) or name not in names:
        raise InputError(f"unknown {kind} {brief(name)}; {choices(name, names)}")


def brief(value: Any) -> str:
    """Return `value` as text of at most a few hundred characters, for a message."""
    try:
        return " ".join(reprlib.repr(value.tolist() if hasattr(value, "tolist") else value).splitlines())
    except ValueError:  # Python writes no numbers of thousands of digits
        return "a number of thousands of digits"


def printable(text: str) -> str:
    """Return `text` with escapes for unprintable characters, which could break the line or hide text."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def is_input_error(error: BaseException) -> bool:
    """Return whether `error` needs no traceback: it means invalid input, or a file that cannot be read or written.

    An OSError that passes through code outside this package and the installed packages does not count, because it comes
    from the code of a task or a method.
    """
    if not isinstance(error, OSError):
        return isinstance(error, InputError)
    paths = [Path(frame.filename) for frame in traceback.extract_tb(error.__traceback__)]
    below_package = itertools.dropwhile(lambda path: not path.is_relative_to(PACKAGE), paths)
    files = [path.resolve() for path in below_package if path.is_file()]
    return all(any(file.is_relative_to(root) for root in (PACKAGE, *LIBRARIES)) for file in files)
