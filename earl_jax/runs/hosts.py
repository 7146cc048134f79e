"""Several hosts that run one program: joining them, the host that writes files, and arrays on several hosts."""

from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from earl_jax.errors import InputError


def gathered(tree: Any) -> Any:
    """Return the arrays of `tree` as NumPy arrays, including those on other hosts; every host must call this."""

    def gather(leaf):
        if isinstance(leaf, jax.Array) and not leaf.is_fully_addressable:
            if leaf.is_fully_replicated:
                return np.asarray(leaf.addressable_data(0))
            return np.asarray(multihost_utils.process_allgather(leaf, tiled=True))
        return np.asarray(leaf)

    return jax.tree.map(gather, tree)


def of_first_host(flag: bool) -> bool:
    """Return the `flag` of the first host; every host must call this."""
    return flag if jax.process_count() == 1 else bool(multihost_utils.broadcast_one_to_all(np.asarray(flag)))


def join_hosts(hosts: str | None) -> None:
    """Join this process with the others that run the same program; None does nothing.

    `hosts` is `auto` on a cluster that jax knows (SLURM, Open MPI), else ADDRESS:PORT,HOSTS,NUMBER, where NUMBER counts
    from 0.

    Raises:
        ValueError: `hosts` has neither form.
    """
    if hosts is None:
        return
    parts = hosts.split(",")
    if hosts != "auto" and (len(parts) != 3 or not all(part.isdigit() for part in parts[1:])):
        raise InputError(f"--hosts takes auto or ADDRESS:PORT,HOSTS,NUMBER, not {hosts!r}")
    if hosts == "auto":
        return jax.distributed.initialize()
    jax.distributed.initialize(parts[0], int(parts[1]), int(parts[2]))


def first_host() -> bool:
    """Return whether this process writes the files of a run."""
    return jax.process_index() == 0
