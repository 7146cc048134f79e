"""XLA's foreign function interface in ctypes: the frame of a call, its buffers, and a Python function as its handler.

Source: XLA's stable C interface (xla/ffi/api/c_api.h, major version 0). Only fields that every minor version has had
since 0.1 are read.
"""

import ctypes
import functools
import math
from collections.abc import Callable
from ctypes import POINTER, Structure, c_char_p, c_int, c_int64, c_size_t, c_uint32, c_void_p
from typing import Any

import numpy as np

MAJOR_VERSION = 0
"""The version of the interface below; XLA refuses to register a handler of another major version than its own."""
METADATA, INTERNAL = 1, 13
"""The type of an extension that requests the version, and the code of an internal error."""


class _Version(Structure):
    _fields_ = [("size", c_size_t), ("extension", c_void_p), ("major", c_int), ("minor", c_int)]


class _Api(Structure):
    _fields_ = [
        ("size", c_size_t), ("extension", c_void_p), ("version", _Version), ("internal", c_void_p),
        ("error_create", c_void_p), ("error_message", c_void_p), ("error_destroy", c_void_p), ("register", c_void_p),
        ("stream_get", c_void_p),
    ]  # fmt: skip


class _Metadata(Structure):
    _fields_ = [("size", c_size_t), ("version", _Version), ("traits", c_uint32)]


class _Extension(Structure):
    _fields_ = [("size", c_size_t), ("type", c_int), ("next", c_void_p), ("metadata", POINTER(_Metadata))]


class Buffer(Structure):
    """An operand or a result: the address of its bytes, and its shape."""

    _fields_ = [
        ("size", c_size_t), ("extension", c_void_p), ("dtype", c_int), ("data", c_void_p), ("rank", c_int64),
        ("dims", POINTER(c_int64)),
    ]  # fmt: skip

    @property
    def count(self) -> int:
        """Number of elements, of four bytes each."""
        return math.prod(self.shape)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of its axes."""
        return tuple(self.dims[: self.rank])

    def elements(self, kind: Any) -> np.ndarray:
        """Return its elements, numbers of the ctypes type `kind`, for a buffer on the host."""
        return np.ctypeslib.as_array((kind * self.count).from_address(self.data or 0))


class _Buffers(Structure):
    _fields_ = [
        ("size", c_size_t), ("extension", c_void_p), ("count", c_int64), ("types", c_void_p),
        ("items", POINTER(POINTER(Buffer))),
    ]  # fmt: skip


class _StreamGet(Structure):
    _fields_ = [("size", c_size_t), ("extension", c_void_p), ("context", c_void_p), ("stream", c_void_p)]


class Frame(Structure):
    """The argument of a foreign function when XLA calls it."""

    _fields_ = [
        ("size", c_size_t), ("extension", POINTER(_Extension)), ("api", POINTER(_Api)), ("context", c_void_p),
        ("stage", c_int), ("inputs", _Buffers), ("outputs", _Buffers),
    ]  # fmt: skip

    @property
    def transfer(self) -> tuple[Buffer, Buffer]:
        """The only operand and the only result."""
        return self.inputs.items[0].contents, self.outputs.items[0].contents

    @property
    def stream(self) -> int:
        """The stream in which a GPU executes this call."""
        request = _StreamGet(ctypes.sizeof(_StreamGet), None, self.context, None)
        if _stream_getter(self.api.contents.stream_get)(ctypes.byref(request)):
            raise RuntimeError("XLA returned no stream")
        return request.stream


@functools.cache
def _stream_getter(address: int) -> Any:
    return ctypes.CFUNCTYPE(c_void_p, POINTER(_StreamGet))(address)


class _ErrorCreate(Structure):
    _fields_ = [("size", c_size_t), ("extension", c_void_p), ("message", c_char_p), ("code", c_int)]


_HANDLER = ctypes.CFUNCTYPE(c_void_p, POINTER(Frame))


def handler(work: Callable[[Frame], None]) -> Any:
    """Return `work` as a handler that XLA can call: it reports its version, and an exception becomes an XLA error."""

    def handle(pointer) -> int | None:
        frame = pointer.contents
        if frame.extension and frame.extension.contents.type == METADATA:
            metadata, version = frame.extension.contents.metadata.contents, frame.api.contents.version
            metadata.version.major, metadata.version.minor, metadata.traits = MAJOR_VERSION, version.minor, 0
            return None
        try:
            work(frame)
        except Exception as error:
            message = f"{type(error).__name__}: {error}".encode()
            request = _ErrorCreate(ctypes.sizeof(_ErrorCreate), None, message, INTERNAL)
            create = ctypes.CFUNCTYPE(c_void_p, POINTER(_ErrorCreate))(frame.api.contents.error_create)
            return create(ctypes.byref(request))
        return None

    return _HANDLER(handle)


def rows_of(buffer: Buffer) -> np.ndarray:
    """Return the float32 `buffer` as rows [n, k]."""
    return buffer.elements(ctypes.c_float).reshape(-1, buffer.shape[-1])
