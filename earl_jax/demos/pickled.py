"""A reader of pickles of one dictionary of numpy arrays.

It interprets the opcodes itself and calls nothing that a file names: unpickling numpy's own classes from an untrusted
file can read and write memory beyond the arrays. It accepts what numpy 1 and 2 write in protocols 0 to 5.
"""

import enum
import pickletools
from typing import Any

import numpy as np

from earl_jax.arrays.plain import array_bytes, build_array, checked_code, element_type, shortened
from earl_jax.errors import InputError

MAX_OPCODES = 100_000
"""Limit for the opcodes of a file, and so for its stack and its memo. An array takes about 40."""
MAX_ITEMS = 8
"""Limit for the items of a tuple. The state of a dtype has 8."""
MAX_PROTOCOL = 5
HINT = "an npz of the arrays, by numpy.savez, can be imported instead"


class _Global(enum.Enum):
    """A name that numpy puts in a pickle."""

    NDARRAY = "numpy.ndarray"
    DTYPE = "numpy.dtype"
    RECONSTRUCT = "_reconstruct"
    FROMBUFFER = "_frombuffer"
    ENCODE = "_codecs.encode"
    BYTES = "bytes"


GLOBALS = {
    "numpy ndarray": _Global.NDARRAY,
    "numpy dtype": _Global.DTYPE,
    "numpy.core.multiarray _reconstruct": _Global.RECONSTRUCT,
    "numpy._core.multiarray _reconstruct": _Global.RECONSTRUCT,
    "numpy.core.numeric _frombuffer": _Global.FROMBUFFER,
    "numpy._core.numeric _frombuffer": _Global.FROMBUFFER,
    "_codecs encode": _Global.ENCODE,
    "__builtin__ bytes": _Global.BYTES,
    "builtins bytes": _Global.BYTES,
}
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
ARGUMENTS = {
    "INT", "BININT", "BININT1", "BININT2",
    "BINSTRING", "SHORT_BINSTRING",
    "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8",
    "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8",
}  # fmt: skip
"""Opcodes that push their argument. Strings of Python 2 are Latin-1 text, as numpy reads them."""
MEMO_OPCODES = {"GET", "BINGET", "LONG_BINGET", "PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"}
CONTAINER_OPCODES = {
    "MARK", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_DICT", "DICT", "SETITEM", "SETITEMS",
}  # fmt: skip
GLOBAL_OPCODES = {"GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD"}


class _Dtype:
    """A dtype of the file: its code, and from BUILD on its numpy type."""

    def __init__(self, code: str) -> None:
        self.code = code
        self.built: np.dtype | None = None


class _Array:
    """An array of the file: without content until BUILD."""

    def __init__(self, built: np.ndarray | None = None) -> None:
        self.built = built


class _Builder:
    """Makes the parts of arrays, up to a limit: their bytes come from the file, and the memo must not multiply them."""

    def __init__(self, file_size: int) -> None:
        self.allowance = 2 * file_size

    def encoded(self, text: str) -> bytes:
        """Return the bytes of Latin-1 text."""
        self._take(len(text))
        return text.encode("latin1")

    def array(self, data: bytes | bytearray, dtype: _Dtype, shape: tuple, order: str) -> np.ndarray:
        """Return an array over `data`."""
        if dtype.built is None:
            raise InputError("an array has an element type without a byte order")
        self._take(array_bytes(dtype.built, shape))
        return build_array(data, dtype.built, shape, order)

    def reduced(self, called: Any, arguments: Any) -> Any:
        """Return what a global stands for with these arguments."""
        match called, arguments:
            case _Global.ENCODE, (str() as text, "latin1"):
                return self.encoded(text)
            case _Global.BYTES, ():
                return b""
            case _Global.DTYPE, (str() as code, 0, 1):
                return _Dtype(checked_code(code))
            case _Global.RECONSTRUCT, (_Global.NDARRAY, (0 as size,), b"b" | "b") if size is not False:
                return _Array()
            case _Global.FROMBUFFER, (bytes() | bytearray() as data, _Dtype() as dtype, tuple() as shape, order, *axes):
                return _Array(self._ordered(data, dtype, shape, order, axes))
            case _Global(), _:
                raise InputError(f"REDUCE calls {called.value} in a way that no plain array needs")
            case _:
                raise InputError("REDUCE calls something that is not a global")

    def _ordered(self, data: Any, dtype: _Dtype, shape: tuple, order: Any, axes: list[Any]) -> np.ndarray:
        match order, axes:
            case (("C" | "F"), []):
                return self.array(data, dtype, shape, order)
            case "K", [tuple() as permutation] if _is_permutation(permutation, len(shape)):
                return self.array(data, dtype, shape, "C").transpose(permutation)
            case _:
                raise InputError("an array's axes are in neither C nor Fortran order, nor in a permutation of them")

    def completed(self, target: Any, state: Any) -> Any:
        """Complete a dtype or an array with its state, once, and return it."""
        match target, state:
            case _Dtype(built=None), (3, str() as byte_order, None, None, None, -1, -1, 0):
                target.built = element_type(target.code, byte_order)
            case _Array(built=None), (
                1,
                tuple() as shape,
                _Dtype() as dtype,
                0 | 1 as fortran,
                bytes() | str() as data,
            ):
                content = data if isinstance(data, bytes) else self.encoded(data)
                target.built = self.array(content, dtype, shape, "F" if fortran else "C")
            case _:
                raise InputError("BUILD sets a state that no plain array and no plain element type has")
        return target

    def _take(self, size: int) -> None:
        self.allowance -= size
        if self.allowance < 0:
            raise InputError("its arrays are larger than the file")


def _is_permutation(axes: tuple, count: int) -> bool:
    return all(type(axis) is int for axis in axes) and sorted(axes) == list(range(count))


class _Machine:
    """The stack, the marks and the memo of an unpickler, over plain values only."""

    def __init__(self, file_size: int) -> None:
        self.builder = _Builder(file_size)
        self.stack: list[Any] = []
        self.below_marks: list[list[Any]] = []
        self.memo: dict[int, Any] = {}

    def step(self, opcode: str, argument: Any) -> None:
        """Interpret one opcode."""
        if opcode in ARGUMENTS:
            self.stack.append(argument)
        elif opcode in CONSTANTS:
            self.stack.append(CONSTANTS[opcode])
        elif opcode in MEMO_OPCODES:
            self._use_memo(opcode, argument)
        elif opcode in CONTAINER_OPCODES:
            self._use_container(opcode)
        elif opcode in GLOBAL_OPCODES:
            self._use_global(opcode, argument)
        elif opcode not in ("PROTO", "FRAME", "STOP"):
            raise InputError(f"it uses the opcode {opcode}, which no dictionary of plain arrays needs; {HINT}")

    def result(self) -> dict[str, np.ndarray]:
        """Return the arrays of the dictionary that is left."""
        (arrays,) = self._pop(1)
        if self.stack or self.below_marks or type(arrays) is not dict:
            raise InputError("it is not one dictionary")
        return {name: array.built for name, array in arrays.items()}

    def _use_memo(self, opcode: str, number: int) -> None:
        if opcode in ("GET", "BINGET", "LONG_BINGET"):
            if number not in self.memo:
                raise InputError(f"{opcode} refers to a value that was not stored")
            self.stack.append(self.memo[number])
            return
        (value,) = self._pop(1)
        self.stack.append(value)
        self.memo[len(self.memo) if opcode == "MEMOIZE" else number] = value

    def _use_container(self, opcode: str) -> None:
        match opcode:
            case "MARK":
                self.below_marks.append(self.stack)
                self.stack = []
            case "TUPLE" | "TUPLE1" | "TUPLE2" | "TUPLE3":
                items = self._pop_group() if opcode == "TUPLE" else self._pop(int(opcode[-1]))
                if len(items) > MAX_ITEMS:
                    raise InputError(f"it has a tuple of more than {MAX_ITEMS} items")
                self.stack.append(tuple(items))
            case "EMPTY_DICT":
                self.stack.append({})
            case "DICT":
                items = self._pop_group()
                self.stack.append(_updated({}, items))
            case "SETITEM" | "SETITEMS":
                items = self._pop_group() if opcode == "SETITEMS" else self._pop(2)
                (arrays,) = self._pop(1)
                self.stack.append(_updated(arrays, items))

    def _use_global(self, opcode: str, argument: Any) -> None:
        match opcode:
            case "REDUCE":
                value = self.builder.reduced(*self._pop(2))
            case "BUILD":
                value = self.builder.completed(*self._pop(2))
            case "STACK_GLOBAL":
                value = _named(*self._pop(2))
            case _:
                value = _named(*argument.split(" ", 1))
        self.stack.append(value)

    def _pop(self, count: int) -> list[Any]:
        if len(self.stack) < count:
            raise InputError("an opcode takes more values than there are")
        values = self.stack[-count:]
        del self.stack[-count:]
        return values

    def _pop_group(self) -> list[Any]:
        if not self.below_marks:
            raise InputError("an opcode takes a group of values, but no MARK begins one")
        values, self.stack = self.stack, self.below_marks.pop()
        return values


def _named(module: Any, name: Any) -> _Global:
    if type(module) is not str or type(name) is not str:
        raise InputError("a global's name is not text")
    if f"{module} {name}" not in GLOBALS:
        raise InputError(f"it asks for {module}.{name}, but only numpy arrays are allowed")
    return GLOBALS[f"{module} {name}"]


def _updated(arrays: Any, items: list[Any]) -> dict[str, _Array]:
    """Put keys and values, which alternate in `items`, into `arrays` and return it."""
    if type(arrays) is not dict or len(items) % 2:
        raise InputError("an opcode puts items into something that is not a dictionary")
    for name, value in zip(items[::2], items[1::2], strict=True):
        if type(name) is not str:
            raise InputError("a key of its dictionary is not text")
        if not isinstance(value, _Array) or value.built is None:
            raise InputError(f"its entry {name[:50]!r} is not a numpy array; {HINT}")
        arrays[name] = value
    return arrays


def load(data: bytes) -> dict[str, np.ndarray]:
    """Return the arrays in a pickle of one dictionary of numpy arrays.

    Raises:
        ValueError: the pickle holds anything else, or is damaged; the message names the opcode or the global.
    """
    try:
        return _load(data)
    except ValueError as error:
        raise InputError(f"not a pickle of numpy arrays: {shortened(error)}") from error


def _load(data: bytes) -> dict[str, np.ndarray]:
    machine = _Machine(len(data))
    for count, (opcode, argument, offset) in enumerate(pickletools.genops(data)):
        if count == MAX_OPCODES:
            raise InputError(f"it has more than {MAX_OPCODES} opcodes")
        _check_argument(opcode.name, argument, data, offset or 0)
        machine.step(opcode.name, argument)
    return machine.result()


def _check_argument(opcode: str, argument: Any, data: bytes, offset: int) -> None:
    """Refuse arguments that pickletools reads although Python's unpickler refuses them or reads another value."""
    if opcode == "PROTO" and argument > MAX_PROTOCOL:
        raise InputError(f"its protocol {argument} is newer than {MAX_PROTOCOL}")
    if opcode in MEMO_OPCODES and argument is not None and not 0 <= argument < MAX_OPCODES:
        raise InputError(f"{opcode} has a number beyond {MAX_OPCODES}")  # larger numbers can share one hash
    if opcode == "INT" and type(argument) is int and not data.startswith(b"%d\n" % argument, offset + 1):
        raise InputError("INT has a number in an unusual form")
