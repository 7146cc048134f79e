"""The manifest of a checkpoint: its step, the shapes of its arrays, and a checksum of every file and of itself."""

import hashlib
import json
from pathlib import Path
from typing import Any

from earl_jax.errors import InputError
from earl_jax.runs.files import BUSY, inside, read_again, read_bytes

MANIFEST = "manifest.json"
LARGEST = 16 << 20
"""Bytes of a manifest at most."""


class DamagedError(InputError):
    """A checkpoint does not match its checksums."""


def checksums(folder: Path) -> dict[str, str]:
    """Return the checksums of all files in the checkpoint `folder`, by their names."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith((MANIFEST, BUSY)))
    return {str(path.relative_to(folder)): checksum(path) for path in files}


def checksum(path: Path) -> str:
    """Return the checksum of the file at `path`."""

    def read():
        with path.open("rb") as handle:
            return hashlib.file_digest(handle, "blake2b").hexdigest()

    return read_again(read)


def manifest_text(body: dict[str, Any]) -> str:
    """Return the text of a manifest with the entries `body` and its own checksum."""
    return json.dumps({**body, "checksum": _sum_of(body)})


def _sum_of(body: dict[str, Any]) -> str:
    return hashlib.blake2b(json.dumps(body, sort_keys=True).encode()).hexdigest()


def verified(path: Path) -> dict[str, Any]:
    """Return the manifest of the checkpoint at `path` after a check of all its files.

    Raises:
        DamagedError: a file is missing or does not match its checksum; the message names it.
    """
    try:
        manifest = _read_manifest(path)
        if manifest["step"] != int(path.name):
            raise InputError(f"{MANIFEST} names step {manifest['step']}")
        for name, expected in manifest["files"].items():
            _verify(path, name, expected)
    except (OSError, ValueError) as error:
        raise DamagedError(f"checkpoint {path} is damaged: {error}") from error
    return manifest


def _read_manifest(path: Path) -> dict[str, Any]:
    """Return the manifest of the checkpoint at `path`; its entries have the right types."""
    try:
        manifest = json.loads(read_bytes(path / MANIFEST, LARGEST))
        if manifest.pop("checksum") != _sum_of(manifest):
            raise InputError("it does not match its checksum")
        if type(manifest["step"]) is not int:
            raise InputError("its step is not a whole number")
        for entry in ("lanes", "files"):
            if not all(isinstance(text, str) for text in manifest[entry].values()):
                raise InputError(f"its {entry} are not texts")
    except KeyError as error:
        raise InputError(f"{MANIFEST} cannot be read (it has no {error})") from error
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{MANIFEST} cannot be read ({error})") from error
    return manifest


def _verify(path: Path, name: str, expected: str) -> None:
    """Raise an InputError unless the file `name` of the checkpoint at `path` has the checksum `expected`."""
    file = inside(path, name)
    if not file.is_file():
        raise InputError(f"{name} is missing")
    if checksum(file) != expected:
        raise InputError(f"{name} does not match its checksum")
