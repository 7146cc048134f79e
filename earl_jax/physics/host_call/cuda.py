"""Host work inside a CUDA stream: copies and waits are queued in the stream, and neither side blocks the other.

The host polls an event, and the stream waits for a word in memory. `cuLaunchHostFunc` wakes a sleeping thread instead,
which took 0.3 ms per control step on a virtual machine.
"""

import ctypes
import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from ctypes import c_int32, c_size_t, c_uint32, c_uint64, c_void_p
from typing import Any

import numpy as np

from earl_jax.physics.host_call.xla_ffi import Buffer, rows_of, view

DEPTH = 4
"""Largest number of jobs of a stream in progress at once; each has its own memory."""
PORTABLE_AND_MAPPED, UNTIMED, AT_LEAST = 3, 2, 0
"""CUDA's flags for host memory that is portable and mapped, for events without timing, and for a wait until >= a
value."""


@functools.cache
def _driver() -> Any:
    return ctypes.CDLL("libcuda.so.1")


def _cuda(function: str, *arguments: Any) -> None:
    code = getattr(_driver(), function)(*arguments)
    if code:
        raise RuntimeError(f"{function} failed with CUDA error {code}")


class Stream:
    """The jobs of one stream, done in order by one thread; `serve` maps input rows to rows of `width` numbers."""

    def __init__(self, serve: Callable[[np.ndarray, int], np.ndarray], width: int, stream: int):
        self.serve, self.width, self.stream = serve, width, stream
        self.number, self.in_progress = 0, dict[int, int]()
        self.events, self.memory = list[c_void_p](), dict[tuple[str, int], int]()
        self.error: Exception | None = None
        self.worker = ThreadPoolExecutor(max_workers=1)
        self.word = view(self._memory("word", 4), 1, c_int32)
        self.word[0] = 0

    def start(self, rows: Buffer, tickets: Buffer) -> None:
        """Queue a job, which the worker starts when the stream has written `rows`."""
        self._raise_failure()
        if len(self.in_progress) == DEPTH:
            raise RuntimeError(f"{DEPTH} control steps of one program are already in progress, which is the maximum")
        self.number += 1
        self.in_progress[tickets.data or 0] = self.number
        source = self._memory("rows", 4 * rows.count, self.number)
        target = self._memory("answer", self._size(rows), self.number)
        self._copy("cuMemcpyDtoHAsync_v2", source, rows.data, rows)
        _cuda("cuMemsetD32Async", c_void_p(tickets.data), self.number, c_size_t(tickets.count), c_void_p(self.stream))
        event, context = self.events.pop() if self.events else _event(), c_void_p()
        _cuda("cuCtxGetCurrent", ctypes.byref(context))
        _cuda("cuEventRecord", event, c_void_p(self.stream))
        into = view(target, self._size(rows) // 4, ctypes.c_float).reshape(-1, self.width)
        self.worker.submit(self._work, self.number, rows_of(rows, source), into, event, context)

    def _size(self, rows: Buffer) -> int:
        return 4 * self.width * (rows.count // rows.shape[-1])

    def finish(self, tickets: Buffer, answer: Buffer) -> None:
        """Make the stream wait for the job of these `tickets` and copy its answer.

        XLA may have moved the tickets in memory; they are still recognised if no other job is in progress.
        """
        self._raise_failure()
        address = tickets.data if tickets.data in self.in_progress else next(iter(self.in_progress), None)
        if address is None or (address != tickets.data and len(self.in_progress) > 1):
            raise RuntimeError(f"{len(self.in_progress)} control steps are in progress, but none has these tickets")
        number = self.in_progress.pop(address)
        awaited = c_void_p(self.stream), c_uint64(self.word.ctypes.data), c_uint32(number), c_uint32(AT_LEAST)
        _cuda("cuStreamWaitValue32_v2", *awaited)
        self._copy("cuMemcpyHtoDAsync_v2", answer.data, self._memory("answer", 4 * answer.count, number), answer)

    def _work(self, number: int, rows: np.ndarray, into: np.ndarray, event: c_void_p, context: c_void_p) -> None:
        """Do one job. If it fails, the program continues with stale memory and its next call raises the error."""
        try:
            _cuda("cuCtxSetCurrent", context)
            _cuda("cuEventSynchronize", event)
            self.events.append(event)
            into[:] = self.serve(rows, self.stream)
        except Exception as error:
            self.error = error
        self.word[0] = number

    def _memory(self, kind: str, count: int, number: int = 0) -> int:
        """Return the address of page-locked memory of `count` bytes, which every `DEPTH`-th job shares.

        Only the thread that fills the stream may allocate memory: an allocation in the worker could wait for a stream
        that waits for the worker.
        """
        if (kind, count) not in self.memory:
            address = c_void_p()
            _cuda("cuMemHostAlloc", ctypes.byref(address), c_size_t(DEPTH * count), c_uint32(PORTABLE_AND_MAPPED))
            self.memory[kind, count] = address.value or 0
        return self.memory[kind, count] + number % DEPTH * count

    def _copy(self, kind: str, target: int | None, source: int | None, buffer: Buffer) -> None:
        _cuda(kind, c_void_p(target), c_void_p(source), c_size_t(4 * buffer.count), c_void_p(self.stream))

    def _raise_failure(self) -> None:
        if self.error is not None:
            raise RuntimeError(f"work on the host failed: {self.error!r}") from self.error


def _event() -> c_void_p:
    event = c_void_p()
    _cuda("cuEventCreate", ctypes.byref(event), c_uint32(UNTIMED))
    return event
