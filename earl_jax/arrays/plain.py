"""Arrays of numbers from the bytes of an untrusted file: every size is checked before anything is allocated."""

import math
import re

import numpy as np

from earl_jax.arrays.content import MAX_BYTES
from earl_jax.errors import InputError

MAX_AXES = 8
ELEMENT_TYPE = re.compile(r"b1|[iu][1248]|f[248]")


def shortened(text: object) -> str:
    """Return the start of a text of an untrusted file in printable ASCII, for a message."""
    return ascii(str(text)[:200])[1:-1]


def checked_code(code: str) -> str:
    """Return the code of an element type, such as `f4`.

    Raises:
        ValueError: it is not a bool, an int, a uint or a float of a usual size.
    """
    if not ELEMENT_TYPE.fullmatch(code):
        raise InputError(f"an array has elements of the type {shortened(code)}, not of bool, int, uint or float")
    return code


def element_type(code: str, byte_order: str) -> np.dtype:
    """Return the dtype of a code such as `f4` and a byte order: `|` for single bytes, and `<` or `>` for others.

    Raises:
        ValueError: the code is invalid, as in `checked_code`, or the byte order doesn't suit it.
    """
    if byte_order not in (("|",) if checked_code(code).endswith("1") else ("<", ">")):
        raise InputError(f"the byte order {shortened(byte_order)!r} does not suit elements of the type {code}")
    return np.dtype(byte_order + code)


def array_bytes(dtype: np.dtype, shape: tuple) -> int:
    """Return the bytes of an array.

    Raises:
        ValueError: the shape has other entries than sizes, or too many or too large ones.
    """
    if len(shape) > MAX_AXES or any(type(size) is not int or not 0 <= size <= MAX_BYTES for size in shape):
        raise InputError(f"an array's shape is not at most {MAX_AXES} sizes from 0 to {MAX_BYTES}")
    if math.prod(max(size, 1) for size in shape) * dtype.itemsize > MAX_BYTES:
        raise InputError(f"an array is larger than {MAX_BYTES >> 20} MiB, the limit")
    return math.prod(shape) * dtype.itemsize


def build_array(data: bytes | bytearray, dtype: np.dtype, shape: tuple, order: str) -> np.ndarray:
    """Return an array over `data`, without a copy, in C or Fortran order (`order` is `C` or `F`).

    Raises:
        ValueError: the shape is invalid, `data` has another size, or a bool is neither 0 nor 1. NumPy counts such bools
            wrongly and then writes beyond its memory.
    """
    size = array_bytes(dtype, shape)
    if len(data) != size:
        raise InputError(f"an array of shape {shape} has {len(data)} bytes instead of {size}")
    if dtype.kind == "b" and np.frombuffer(data, np.uint8).max(initial=0) > 1:
        raise InputError("an array of bools has other values than 0 and 1")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if order == "F" else "C")
