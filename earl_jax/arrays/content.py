"""The content of a file that can be anything, up to a size."""

import stat
from pathlib import Path

from earl_jax.errors import InputError

MAX_BYTES = 512 << 20
"""Size limit of a file, of the arrays in it, and of the float32 arrays made from them: millions of transitions."""


def read_bytes(path: Path, limit: int | None = MAX_BYTES) -> bytes:
    """Return the content of a file.

    Raises:
        ValueError: it is not a regular file, or larger than `limit` bytes.
        OSError: it cannot be read.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise InputError("not a regular file")
    if limit is not None and status.st_size > limit:
        raise InputError(f"larger than {limit >> 20} MiB, the limit")
    with path.open("rb") as handle:
        return handle.read(status.st_size)
