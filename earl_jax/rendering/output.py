"""Writing pictures: optional libraries, and files that appear only when they are complete."""

import contextlib
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError


def library(name: str) -> Any:
    """Return the module `name` of an optional library.

    Raises:
        ValueError: it is not installed; the message names the extra to install.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(f"pictures need {name.partition('.')[0]}: pip install 'earl-jax[render]'") from error


@contextlib.contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` to write to, and rename it to `path` if no exception was raised."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    part.unlink(missing_ok=True)  # a link there would be followed
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
