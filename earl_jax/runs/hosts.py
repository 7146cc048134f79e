"""Several hosts that run one program: joining them, the host that writes files, and arrays on several hosts."""

import atexit
import contextlib
import hashlib
import os
import re
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from earl_jax.errors import InputError, is_input_error


@contextlib.contextmanager
def failing_at_once() -> Iterator[None]:
    """After an error in this context, let this process end without jax's wait for the other hosts, which wait for it.

    A later context without an error, after which the process can go on, takes that back.
    """
    try:
        yield
        atexit.unregister(_leave)
    except BaseException as error:
        ends_all = hasattr(error, "exit_code")  # a Stopped, after which the first host has files to write
        if jax.distributed.is_initialized() and not ends_all:
            code = 130 if isinstance(error, KeyboardInterrupt) else 2 if is_input_error(error) else 1
            atexit.register(_leave, code)  # it runs before jax's own
        raise


def _leave(code: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    if first_host():
        time.sleep(1)  # jax aborts the others when the first host ends: let them say why they end
    os._exit(code)


def gathered(tree: Any) -> Any:
    """Return the arrays of `tree` as NumPy arrays, including those on other hosts; every host must call this.

    Raises:
        ValueError: another host has ended.
    """

    def gather(leaf):
        if isinstance(leaf, jax.Array) and not leaf.is_fully_addressable:
            if leaf.is_fully_replicated:
                return np.asarray(leaf.addressable_data(0))
            return _of_all(leaf, tiled=True)
        return np.asarray(leaf)

    return jax.tree.map(gather, tree)


def of_all_hosts(numbers: Sequence[int] | np.ndarray) -> np.ndarray:
    """Return the `numbers` [n] of every host, int32 [hosts, n]; every host must call this. Errors as `gathered`."""
    own = np.asarray(numbers, np.int32)
    return own[None] if jax.process_count() == 1 else _of_all(own)


def require_same_on_hosts(*arguments: object) -> None:
    """Raise an InputError unless all hosts call this with the same `arguments`, plain values, or if another one has ended."""
    digest = np.frombuffer(hashlib.blake2b(repr(arguments).encode(), digest_size=8).digest(), np.int32)
    if (of_all_hosts(digest) != digest).any():
        raise InputError("the hosts have different arguments: start all of them with the same command")


def _of_all(array: jax.Array | np.ndarray, tiled: bool = False) -> np.ndarray:
    try:
        return np.asarray(multihost_utils.process_allgather(array, tiled=tiled))
    except (RuntimeError, ValueError) as error:  # jax has no class for it
        cause = str(error).partition("\n")[0]
        remedy = "start the run again on all hosts with earl-jax resume"
        raise InputError(f"another host has ended ({cause}); {remedy}") from error


def join_hosts(hosts: str | None) -> None:
    """Join this process with the others that run the same program; None does nothing.

    `hosts` is `auto` on a cluster that jax knows (SLURM, Open MPI), else ADDRESS:PORT,HOSTS,NUMBER, where NUMBER counts
    from 0.

    Raises:
        ValueError: `hosts` has neither form, NUMBER is not below HOSTS, or jax detects no cluster.
    """
    if hosts is None:
        return
    if hosts == "auto":
        try:
            return jax.distributed.initialize()
        except ValueError as error:
            raise InputError(f"--hosts auto: no cluster ({error}); give ADDRESS:PORT,HOSTS,NUMBER") from error
    parts = re.fullmatch(r"(.+:[0-9]+),([0-9]+),([0-9]+)", hosts)
    if not parts or int(parts[3]) >= int(parts[2]):
        raise InputError(f"--hosts takes auto or ADDRESS:PORT,HOSTS,NUMBER, where NUMBER counts from 0, not {hosts!r}")
    jax.distributed.initialize(parts[1], int(parts[2]), int(parts[3]))


def first_host() -> bool:
    """Return whether this process writes the files of a run."""
    return jax.process_index() == 0
