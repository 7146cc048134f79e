"""A cache of compiled programs on disk, so that a second start of the same program compiles nothing.

jax's own cache keeps entries that a kill or a full disk has truncated: every later start warns and compiles again. Ours
ends each entry with a checksum, removes an entry whose checksum does not match, and stores the program anew.
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


def folder() -> Path | None:
    """Return the folder of compiled programs: `$EARL_JAX_CACHE`, else earl_jax/programs in the user's cache, if any."""
    if named := os.environ.get(VARIABLE):
        return Path(named)
    caches = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return None if caches.startswith("~") else Path(caches, "earl_jax", "programs")  # a user of a container has no home


def use_program_cache() -> None:
    """Configure jax to store compiled programs in `folder()`, unless another folder is configured.

    `JAX_ENABLE_COMPILATION_CACHE=false` disables the cache. The key of a program covers its code, shapes, jax version
    and device.
    """
    config: Any = jax.config
    place = folder()
    if place and config.jax_compilation_cache_dir is None:
        _check_entries()
        config.update("jax_compilation_cache_dir", str(place))


@functools.cache
def _check_entries() -> None:
    """Let jax open a cache of checked entries. A jax release without these modules keeps its own cache."""
    with contextlib.suppress(ImportError, AttributeError):
        module: Any = importlib.import_module("jax._src.compilation_cache")
        module.LRUCache = checked(module.LRUCache)


def checked(cache: Any) -> Any:
    """Return a subclass of jax's `cache` that ends entries with a checksum and removes those with a wrong checksum."""

    class CheckedCache(cache):
        def get(self, key: str) -> bytes | None:
            content = super().get(key)
            if content is None:
                return None
            program, checksum = content[:-CHECKSUM_SIZE], content[-CHECKSUM_SIZE:]
            if _checksum(program) == checksum:
                return program
            with contextlib.suppress(OSError):  # a folder that cannot be written to
                (Path(self.path) / f"{key}-cache").unlink()  # jax does not replace an entry
            return None

        def put(self, key: str, value: bytes) -> None:
            super().put(key, value + _checksum(value))

    return CheckedCache


def _checksum(program: bytes) -> bytes:
    return hashlib.blake2b(program, digest_size=CHECKSUM_SIZE).digest()
