"""Work on the host inside a jitted program: rows of a device's memory in, rows out.

`jax.pure_callback` would do the same, but a program that holds one is never kept by the persistent compilation cache, takes
three times as long a call and stops a GPU until the host has answered. A foreign function is known to XLA by its name, and on a
GPU it only puts its copies and signals into the stream: what a program does between `launch` and `land` runs meanwhile.
"""

import ctypes
import functools
import itertools
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from ctypes import c_int32, c_size_t, c_uint32, c_void_p
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.physics.xla import Buffer, Frame, handler, rows_of, view

Serve = Callable[[np.ndarray, int], np.ndarray]
"""Host work: float32 rows [n, k] and the stream they come from (0 on a CPU) in, float32 rows [n, m] out."""
TICKET = jax.ShapeDtypeStruct((1,), jnp.int32)
PORTABLE = 1
"""Flag of page-locked memory that every device may use."""
_SERVICES: dict[str, "Service"] = {}
_KEPT: dict[tuple[str, str], Any] = {}
"""Handlers that XLA knows, which must outlive every program."""


class Line:
    """How one call reaches memory and host: at once on a CPU, in the order of its stream on a GPU."""

    stream = 0

    def room(self, buffer: Buffer) -> int:
        """Return the address at which the host reads or writes what is, or will be, in the buffer."""
        return buffer.data or 0

    def fetch(self, buffer: Buffer) -> int:
        """Return `room` with the buffer's bytes on the way there."""
        return self.room(buffer)

    def send(self, buffer: Buffer) -> None:
        """Put what will then stand in `room` into the buffer."""

    def call(self, function: Callable[[], None]) -> None:
        """Run `function` once everything before it is done."""
        function()


class CudaLine(Line):
    """The stream of one call, and the page-locked memory that its transfers of one size take turns in."""

    def __init__(self, frame: Frame):
        self.stream = frame.stream

    def room(self, buffer: Buffer) -> int:
        return _page_locked(self.stream, 4 * buffer.count, buffer.dtype)

    def fetch(self, buffer: Buffer) -> int:
        self._copy("cuMemcpyDtoHAsync_v2", self.room(buffer), buffer.data, buffer)
        return self.room(buffer)

    def send(self, buffer: Buffer) -> None:
        self._copy("cuMemcpyHtoDAsync_v2", buffer.data, self.room(buffer), buffer)

    def call(self, function: Callable[[], None]) -> None:
        number = next(_NUMBERS)
        _WAITING[number] = function
        _cuda("cuLaunchHostFunc", c_void_p(self.stream), _RUN, c_void_p(number))

    def _copy(self, kind: str, target: int | None, source: int | None, buffer: Buffer) -> None:
        _cuda(kind, c_void_p(target), c_void_p(source), c_size_t(4 * buffer.count), c_void_p(self.stream))


_NUMBERS = itertools.count(1)
_WAITING: dict[int, Callable[[], None]] = {}
_RUN = ctypes.CFUNCTYPE(None, c_void_p)(lambda number: _WAITING.pop(number)())


@functools.cache
def _driver() -> Any:
    return ctypes.CDLL("libcuda.so.1")


def _cuda(function: str, *arguments: Any) -> None:
    code = getattr(_driver(), function)(*arguments)
    if code:
        raise RuntimeError(f"{function} failed with CUDA error {code}")


@functools.cache
def _page_locked(stream: int, count: int, kind: int) -> int:
    del stream, kind
    address = c_void_p()
    _cuda("cuMemHostAlloc", ctypes.byref(address), c_size_t(count), c_uint32(PORTABLE))
    return address.value or 0


class Service:
    """Host work in two halves: `launch` takes rows and gives each a ticket, `land` trades tickets for the answer.

    Nothing can fail in the middle of a stream: an answer that could not be had is NaN, and the next call says why.
    """

    def __init__(self, serve: Serve):
        self.serve = serve
        self._numbers, self._jobs = itertools.count(1), dict[int, Future]()
        self._crew, self._error = ThreadPoolExecutor(), None

    def step(self, frame: Frame) -> None:
        """Answer at once, on a CPU."""
        rows, answer = frame.transfer
        rows_of(answer)[:] = self.serve(rows_of(rows), Line.stream)

    def launch(self, frame: Frame, line: Line) -> None:
        """Begin the work on rows as soon as they are there."""
        self._complain()
        rows, tickets = frame.transfer
        sent = rows_of(rows, line.fetch(rows))
        slips = view(line.room(tickets), tickets.count, c_int32)

        def begin():
            slips[:] = number = next(self._numbers) & 0x7FFFFFFF
            self._jobs[number] = self._crew.submit(self.serve, sent.copy(), line.stream)

        line.call(begin)
        line.send(tickets)

    def land(self, frame: Frame, line: Line) -> None:
        """Wait for the work that the tickets stand for and hand out its answer."""
        self._complain()
        tickets, answer = frame.transfer
        slips = view(line.fetch(tickets), tickets.count, c_int32)
        handed = rows_of(answer, line.room(answer))

        def finish():
            try:
                handed[:] = self._jobs.pop(int(slips[0])).result()
            except Exception as error:
                handed[:], self._error = np.nan, error

        line.call(finish)
        line.send(answer)

    def _complain(self) -> None:
        if self._error is not None:
            raise RuntimeError(f"work on the host failed: {self._error!r}") from self._error


def register(name: str, serve: Serve) -> None:
    """Make `serve` known to XLA as `<name>.step` (CPU), `<name>.launch` and `<name>.land` (CPU and CUDA), from now on."""
    known = name in _SERVICES
    if not known or _SERVICES[name].serve is not serve:
        _SERVICES[name] = Service(serve)
    if known:
        return
    targets = {
        ("step", "cpu"): lambda frame: _SERVICES[name].step(frame),
        ("launch", "cpu"): lambda frame: _SERVICES[name].launch(frame, Line()),
        ("land", "cpu"): lambda frame: _SERVICES[name].land(frame, Line()),
        ("launch", "CUDA"): lambda frame: _SERVICES[name].launch(frame, CudaLine(frame)),
        ("land", "CUDA"): lambda frame: _SERVICES[name].land(frame, CudaLine(frame)),
    }
    for (part, platform), work in targets.items():
        _KEPT[f"{name}.{part}", platform] = target = handler(work)
        jax.ffi.register_ffi_target(f"{name}.{part}", jax.ffi.pycapsule(target), platform=platform)


def step(name: str, row: jax.Array, width: int) -> jax.Array:
    """Return the answer [width] of the registered `name` to one lane's `row [k]`, on a CPU; under vmap lanes go together."""
    return _call(f"{name}.step", row, jax.ShapeDtypeStruct((width,), jnp.float32))


def launch(name: str, row: jax.Array) -> jax.Array:
    """Return the ticket [1] of work begun on one lane's `row [k]`."""
    return _call(f"{name}.launch", row, TICKET)


def land(name: str, ticket: jax.Array, width: int) -> jax.Array:
    """Return the answer [width] to the row that `ticket` was given for."""
    return _call(f"{name}.land", ticket, jax.ShapeDtypeStruct((width,), jnp.float32))


def _call(target: str, operand: jax.Array, answer: jax.ShapeDtypeStruct) -> jax.Array:
    return jax.ffi.ffi_call(target, answer, vmap_method="broadcast_all")(operand)
