"""Compiled programs kept on the disk, so that a second start of the same program compiles nothing."""

import os
from pathlib import Path
from typing import Any

import jax

VARIABLE = "EARL_JAX_CACHE"


def folder() -> Path:
    """Return where compiled programs are kept: `$EARL_JAX_CACHE`, else earl_jax/programs in the user's cache folder."""
    if named := os.environ.get(VARIABLE):
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "earl_jax" / "programs"


def keep_programs() -> None:
    """Have jax keep compiled programs in `folder()`, unless it was told of another place.

    `JAX_ENABLE_COMPILATION_CACHE=false` keeps none. Programs differ by their code, shapes, jax and device, so none can be
    mistaken for another.
    """
    config: Any = jax.config
    if config.jax_compilation_cache_dir is None:
        config.update("jax_compilation_cache_dir", str(folder()))
