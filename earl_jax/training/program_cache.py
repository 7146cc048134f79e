"""A cache of compiled programs on disk, so that a second start of the same program compiles nothing.

jax's own cache keeps an entry that a kill or a full disk truncated: every later start warns and compiles again. Ours ends each
entry with a checksum, removes an entry that does not match it, and stores the program anew.
"""

import contextlib
import functools
import hashlib
import importlib
import os
from pathlib import Path
from typing import Any

import jax

VARIABLE = "EARL_JAX_CACHE"
CHECKSUM_SIZE = 32
ENTRY = "-cache"
"""The end of the name of jax's entries."""


def folder() -> Path:
    """Return the folder of compiled programs: `$EARL_JAX_CACHE`, else earl_jax/programs in the user's cache folder."""
    if named := os.environ.get(VARIABLE):
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "earl_jax" / "programs"


def keep_programs() -> None:
    """Configure jax to store compiled programs in `folder()`, unless another folder is configured.

    `JAX_ENABLE_COMPILATION_CACHE=false` stores none. The key of a program covers its code, shapes, jax version and
    device.
    """
    config: Any = jax.config
    if config.jax_compilation_cache_dir is None:
        _check_entries()
        config.update("jax_compilation_cache_dir", str(folder()))


class CheckedCache:
    """jax's cache `files`, with a checksum at the end of each entry: one that does not match is removed."""

    def __init__(self, files: Any):
        self._files = files

    def __getattr__(self, name: str) -> Any:
        return getattr(self._files, name)

    def get(self, key: str) -> bytes | None:
        """Return the program stored as `key`, or None if there is no intact one."""
        content = self._files.get(key)
        if content is None:
            return None
        program, checksum = content[:-CHECKSUM_SIZE], content[-CHECKSUM_SIZE:]
        if _checksum(program) == checksum:
            return program
        with contextlib.suppress(OSError):  # a folder that cannot be written to
            (Path(self._files.path) / f"{key}{ENTRY}").unlink()  # jax does not replace an entry
        return None

    def put(self, key: str, value: bytes) -> None:
        """Store the program `value` as `key`."""
        self._files.put(key, value + _checksum(value))


def _checksum(program: bytes) -> bytes:
    return hashlib.blake2b(program, digest_size=CHECKSUM_SIZE).digest()


def _check_entries() -> None:
    """Let jax open a `CheckedCache`. A release without these modules keeps its own."""
    with contextlib.suppress(ImportError, AttributeError):
        module: Any = importlib.import_module("jax._src.compilation_cache")
        original = module.LRUCache
        if not hasattr(original, "__wrapped__"):
            module.LRUCache = functools.wraps(original)(
                lambda *args, **options: CheckedCache(original(*args, **options))
            )
