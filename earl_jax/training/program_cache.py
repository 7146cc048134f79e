"""A cache of compiled programs on disk, so that a second start of the same program compiles nothing."""

import os
from pathlib import Path
from typing import Any

import jax

VARIABLE = "EARL_JAX_CACHE"


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
        config.update("jax_compilation_cache_dir", str(folder()))
