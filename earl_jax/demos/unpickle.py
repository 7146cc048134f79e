"""A program that reads a pickle of a dictionary of numpy arrays from its input and writes an npz to its output.

`importer` runs it in a process of its own, because a hostile pickle can take all memory and time. It calls nothing that
a pickle names: each allowed name stands for a class or a function below, which check what numpy's own would trust. Its
arguments are the names of the arrays. It imports no other module of the package, so it starts quickly.
"""

import contextlib
import io
import pickle
import re
import sys
from typing import Any

import numpy as np

ELEMENTS = re.compile(r"b1|[iu][1248]|f[248]")
MEMORY, SECONDS = 512 << 20, 60
"""Limits of the process: of the memory beside four times the size of the pickle, and of the time on the processor."""
HINT = "an npz of the arrays, by numpy.savez, can be imported instead"


class Dtype:
    """The type of elements that a pickle describes: `built` from BUILD on."""

    def __init__(self, code: str, align: bool, copy: bool) -> None:
        if not ELEMENTS.fullmatch(code):
            raise ValueError(f"an array has elements of the type {code}, not of bool, int, uint or float")
        self.code = code

    def __setstate__(self, state: tuple) -> None:
        _, order, *rest = state
        if order not in ("<", ">", "|") or rest != [None, None, None, -1, -1, 0]:
            raise ValueError("a type of elements has fields, a size or flags of its own")
        self.built = np.dtype(order + self.code)


class Array:
    """An array that a pickle describes: `built` from BUILD on."""

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, fortran, data = state
        self.built = _array(data, dtype, shape, "F" if fortran else "C")


def _array(data: Any, dtype: Any, shape: tuple, order: str) -> np.ndarray:
    if not isinstance(dtype, Dtype):
        raise ValueError("an array has no type of elements")
    data = data.encode("latin1") if isinstance(data, str) else data  # Python 2
    return np.frombuffer(data, dtype.built).reshape(shape, order="F" if order == "F" else "C")


def _reconstruct(base: type, shape: tuple, code: Any) -> Array:
    return Array()


def _frombuffer(data: Any, dtype: Any, shape: tuple, order: str, axes: tuple | None = None) -> Array:
    array = Array()
    array.built = _array(data, dtype, shape, order)
    array.built = array.built if axes is None else array.built.transpose(axes)
    return array


def _encode(text: str, codec: str) -> bytes:
    if codec != "latin1":
        raise ValueError(f"it encodes text with {codec}")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    return b""


ALLOWED = {
    "numpy.ndarray": Array,
    "numpy.dtype": Dtype,
    "numpy.core.multiarray._reconstruct": _reconstruct,
    "numpy._core.multiarray._reconstruct": _reconstruct,
    "numpy.core.numeric._frombuffer": _frombuffer,
    "numpy._core.numeric._frombuffer": _frombuffer,
    "_codecs.encode": _encode,
    "__builtin__.bytes": _no_bytes,
    "builtins.bytes": _no_bytes,
}


class Reader(pickle.Unpickler):
    """Python's unpickler with nothing but the names in `ALLOWED`."""

    def find_class(self, module_name: str, global_name: str) -> Any:
        """Return what a name of the pickle stands for."""
        if f"{module_name}.{global_name}" not in ALLOWED:
            raise ValueError(f"it asks for {module_name}.{global_name}, but only numpy arrays are allowed")
        return ALLOWED[f"{module_name}.{global_name}"]


def read(data: bytes, names: list[str]) -> dict[str, Any]:
    """Return those arrays in the dictionary of a pickle that have one of `names`."""
    content = Reader(io.BytesIO(data), encoding="latin1").load()
    if type(content) is not dict:
        raise ValueError(f"it is not a dictionary; {HINT}")
    entries = {name: content[name] for name in names if name in content}
    for name, entry in entries.items():
        if not isinstance(entry, Array):
            raise ValueError(f"its entry {name!r} is not a numpy array; {HINT}")
    if sum(entry.built.nbytes for entry in entries.values()) > 2 * len(data):
        raise ValueError("its arrays are larger than the file")
    return {name: entry.built for name, entry in entries.items()}


def _limit(size: int) -> None:
    """Limit the process, where the system can, to the memory and time that a pickle of `size` bytes may take."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY + 4 * size, MEMORY + 4 * size))


def main() -> None:
    """Read the pickle; an error is a line of text and the exit status 1."""
    data, out = sys.stdin.buffer.read(), io.BytesIO()
    _limit(len(data))
    try:
        np.savez(out, **read(data, sys.argv[1:]))
    except MemoryError:
        sys.exit("it takes more memory than its size explains")
    except Exception as error:
        sys.exit(str(error) or type(error).__name__)
    sys.stdout.buffer.write(out.getbuffer())


if __name__ == "__main__":
    main()
