"""The reader of npz files, which may be untrusted."""

from __future__ import annotations

import io
import stat
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from earl_jax.errors import InputError, printable

if TYPE_CHECKING:
    import numpy as np

MAX_BYTES = 512 << 20
"""Size limit of a file, of the arrays in it, and of the float32 arrays made from them: millions of transitions."""
MAX_MEMBERS = 10_000
"""Largest number of members in an npz, because zipfile reads the whole list of them."""
FREE_BYTES = 64 << 20
MAX_RATIO = 100
"""Arrays larger than `FREE_BYTES` may have at most this many times the size of the file."""
COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""zipfile unpacks other compressions beyond the size that a member declares."""


def read_bytes(path: Path) -> bytes:
    """Return the content of a file.

    Raises:
        ValueError: it is not a regular file, or larger than `MAX_BYTES`.
        OSError: it cannot be read.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise InputError("not a regular file")
    if status.st_size > MAX_BYTES:
        raise InputError(f"larger than {MAX_BYTES >> 20} MiB, the limit")
    with path.open("rb") as handle:
        return handle.read(status.st_size)


def load_npz(data: bytes, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the arrays called `names` from the npz file with the content `data`; other members are not read.

    Raises:
        ValueError: the file is damaged, one of these arrays has more than numbers and bools, or they are too large.
    """
    import numpy as np  # commands that read files without arrays start faster without it

    try:
        _check_sizes(data, {f"{name}.npy" for name in names})
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in names if name in stored.files}
        for array in arrays.values():
            kind = array.dtype.kind
            if kind not in "biuf":
                raise InputError(f"an array has elements of the type {array.dtype}, not of bool, int, uint or float")
            if kind == "b" and array.view(np.uint8).max(initial=0) > 1:  # NumPy would write beyond its memory
                raise InputError("an array of bools has other values than 0 and 1")
        return arrays
    except Exception as error:  # damage makes zipfile and NumPy raise errors of many types
        raise InputError(f"not an npz file of plain arrays: {printable(str(error)[:200])}") from error


def _check_sizes(data: bytes, files: set[str]) -> None:
    """Check the sizes that an npz declares: zipfile and NumPy use no more memory than declared."""
    if data.count(b"PK\1\2") > MAX_MEMBERS:
        raise InputError(f"it has more than {MAX_MEMBERS} members")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [info for info in archive.infolist() if info.filename in files]
    if any(info.compress_type not in COMPRESSIONS for info in members):
        raise InputError("a member is packed in another way than numpy packs")
    total = sum(info.file_size for info in members)
    if total > min(MAX_BYTES, max(FREE_BYTES, MAX_RATIO * len(data))):
        raise InputError(f"its arrays are larger than {MAX_BYTES >> 20} MiB or {MAX_RATIO} times the file, the limits")
