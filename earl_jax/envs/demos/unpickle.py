"""A program that reads a pickle of a dictionary of numpy arrays from its input and writes an npz to its output.

`importer` runs this program in a process of its own, because a hostile pickle can use up memory and time. It never
calls what a pickle names: each allowed name stands for a class or function below, which checks what numpy's would
trust. The arguments are the names of the arrays. It imports no other module of the package, so it starts quickly.
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
"""Limits of the process: memory in addition to four times the size of the pickle, and seconds of processor time."""
HINT = "an npz of the arrays, by numpy.savez, can be imported instead"


class Dtype:
    """The type of elements that a pickle describes."""

    def __init__(self, code: str, *_: Any) -> None:
        if not ELEMENTS.fullmatch(code):
            raise ValueError(f"an array has elements of the type {code}, not of bool, int, uint or float")
        self.code = code

    def __setstate__(self, state: tuple) -> None:
        _, order, *rest = state
        if order not in ("<", ">", "|") or rest != [None, None, None, -1, -1, 0]:
            raise ValueError("a type of elements has fields, a size or flags of its own")
        self.dtype = np.dtype(order + self.code)


class Array:
    """An array that a pickle describes; `values` are set once its data is read."""

    values: Any = None

    def __init__(self, *arguments: Any) -> None:
        if len(arguments) > 3:  # as _frombuffer, else as _reconstruct, whose arguments say nothing
            self._fill(*arguments)

    def _fill(self, data: Any, dtype: Dtype, shape: tuple, order: str, axes: tuple | None = None) -> None:
        data = data.encode("latin1") if isinstance(data, str) else data  # Python 2
        values = np.frombuffer(data, dtype.dtype).reshape(shape, order="F" if order == "F" else "C")
        self.values = values if axes is None else values.transpose(axes)

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, fortran, data = state
        self._fill(data, dtype, shape, "F" if fortran else "C")


def _encode(text: str, codec: str) -> bytes:
    if codec != "latin1":
        raise ValueError(f"it encodes text with {codec}")
    return text.encode("latin1")


ALLOWED = {
    "numpy.ndarray": Array,
    "numpy.dtype": Dtype,
    "numpy.core.multiarray._reconstruct": Array,
    "numpy.core.numeric._frombuffer": Array,
    "_codecs.encode": _encode,
    "builtins.bytes": lambda: b"",
}


class Reader(pickle.Unpickler):
    """Python's unpickler, restricted to the names in `ALLOWED`."""

    def find_class(self, module_name: str, global_name: str) -> Any:
        """Return the class or function that a name in the pickle stands for."""
        module_name = module_name.replace("numpy._core.", "numpy.core.").replace("__builtin__", "builtins")
        name = f"{module_name}.{global_name}"
        if name not in ALLOWED:
            raise ValueError(f"it asks for {name}, but only numpy arrays are allowed")
        return ALLOWED[name]


def read(data: bytes, names: list[str]) -> dict[str, Any]:
    """Return the arrays called `names` from the dictionary in a pickle, as far as it contains them."""
    content = Reader(io.BytesIO(data), encoding="latin1").load()
    if type(content) is not dict:
        raise ValueError(f"it is not a dictionary; {HINT}")
    arrays = {}
    for name in [name for name in names if name in content]:
        arrays[name] = getattr(content[name], "values", None)
        if not isinstance(arrays[name], np.ndarray):
            raise ValueError(f"its entry {name!r} is not a numpy array; {HINT}")
    if sum(array.nbytes for array in arrays.values()) > 2 * len(data):  # several can share the same bytes
        raise ValueError("its arrays are larger than the file")
    return arrays


def main() -> None:
    """Read the pickle and write the npz; an error is printed as one line, with exit status 1."""
    data, out = sys.stdin.buffer.read(), io.BytesIO()
    with contextlib.suppress(ImportError, ValueError, OSError):  # a system without limits
        import resource

        for limit, size in (("CORE", 0), ("CPU", SECONDS), ("AS", MEMORY + 4 * len(data))):
            resource.setrlimit(getattr(resource, f"RLIMIT_{limit}"), (size, size))
    try:
        np.savez(out, **read(data, sys.argv[1:]))
    except MemoryError:
        sys.exit("it uses more memory than its size explains")
    except Exception as error:
        sys.exit(str(error) or type(error).__name__)
    sys.stdout.buffer.write(out.getbuffer())


if __name__ == "__main__":
    main()
