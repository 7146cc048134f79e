"""Host work inside a CUDA stream: copies and waits are queued in the stream, and neither side blocks the other.

The host polls an event, and the stream waits for a word in memory. `cuLaunchHostFunc` wakes a sleeping thread instead,
which took 0.3 ms per control step on a virtual machine.
"""

import ctypes
import functools
import queue
import threading
from collections.abc import Callable
from ctypes import c_size_t, c_uint32, c_void_p
from typing import Any, NamedTuple

import numpy as np

from earl_jax.physics.host_call.xla_ffi import Buffer, view

DEPTH = 4
"""Largest number of jobs of a stream in progress at once; each has its own memory."""
PORTABLE_AND_MAPPED, UNTIMED, AT_LEAST = 3, 2, 0
"""CUDA's flags for host memory that is portable and mapped, for events without timing, and for a wait until >= a
value."""
FUNCTIONS = (
    "cuCtxGetCurrent", "cuCtxSetCurrent", "cuEventCreate", "cuEventRecord", "cuEventSynchronize", "cuMemHostAlloc",
    "cuMemcpyDtoHAsync_v2", "cuMemcpyHtoDAsync_v2", "cuMemsetD32Async", "cuStreamWaitValue32_v2",
)  # fmt: skip
"""The functions of CUDA's driver that a stream calls."""


@functools.cache
def driver() -> Any:
    """Return CUDA's driver library.

    Raises:
        OSError: there is none.
        AttributeError: it lacks one of `FUNCTIONS`.
    """
    library = ctypes.CDLL("libcuda.so.1")
    for function in FUNCTIONS:
        getattr(library, function)
    return library


def _cuda(function: str, *arguments: Any) -> None:
    code = getattr(driver(), function)(*arguments)
    if code:
        raise RuntimeError(f"{function} failed with CUDA error {code}")


class HostRows(NamedTuple):
    """Page-locked memory of the host at `address`, as float32 `rows [n, k]`."""

    rows: np.ndarray
    address: c_void_p


class Job(NamedTuple):
    """A job: its number, the `rows` to read once `event` has happened, and those of the `answer` to write."""

    number: int
    rows: np.ndarray
    answer: np.ndarray
    event: c_void_p


class Stream:
    """The jobs of one stream, done in order by one thread; `serve` maps input rows to rows of `width` numbers.

    The thread of XLA that fills the stream runs this code for each control step, and a GPU waits for a late one, so
    it allocates and looks up nothing twice.
    """

    def __init__(self, serve: Callable[[np.ndarray, int], np.ndarray], width: int, stream: int):
        self.serve, self.width, self.stream = serve, width, stream
        self.number, self.in_progress = 0, dict[int, int]()
        self.handle = c_void_p(stream)
        self.events, self.memory = list[c_void_p](), dict[tuple[str, int, int], list[HostRows]]()
        self.error: Exception | None = None
        self.word = self._slot("word", 1, 1, 0)
        self.done = self.word.rows[0].view(np.int32)
        self.jobs: queue.SimpleQueue[Job] = queue.SimpleQueue()
        context = c_void_p()
        _cuda("cuCtxGetCurrent", ctypes.byref(context))
        threading.Thread(target=self._work, args=(context,), daemon=True).start()

    def start(self, rows: Buffer, tickets: Buffer) -> None:
        """Queue a job, which the worker starts when the stream has written `rows`."""
        self._raise_failure()
        if len(self.in_progress) == DEPTH:
            raise RuntimeError(f"{DEPTH} control steps of one program are already in progress, which is the maximum")
        self.number += 1
        self.in_progress[tickets.data or 0] = self.number
        columns = rows.shape[-1]
        lanes = rows.count // columns
        source, answer = self._slot("rows", lanes, columns), self._slot("answer", lanes, self.width)
        _cuda("cuMemcpyDtoHAsync_v2", source.address, c_void_p(rows.data), c_size_t(source.rows.nbytes), self.handle)
        _cuda("cuMemsetD32Async", c_void_p(tickets.data), self.number, c_size_t(tickets.count), self.handle)
        event = self.events.pop() if self.events else _event()
        _cuda("cuEventRecord", event, self.handle)
        self.jobs.put(Job(self.number, source.rows, answer.rows, event))

    def finish(self, tickets: Buffer, answer: Buffer) -> None:
        """Make the stream wait for the job of these `tickets` and copy its answer.

        XLA may have moved the tickets in memory; they are still recognised if no other job is in progress.
        """
        self._raise_failure()
        address = tickets.data if tickets.data in self.in_progress else next(iter(self.in_progress), None)
        if address is None or (address != tickets.data and len(self.in_progress) > 1):
            raise RuntimeError(f"{len(self.in_progress)} control steps are in progress, but none has these tickets")
        number = self.in_progress.pop(address)
        source = self._slot("answer", answer.count // self.width, self.width, number)
        _cuda("cuStreamWaitValue32_v2", self.handle, self.word.address, c_uint32(number), c_uint32(AT_LEAST))
        _cuda("cuMemcpyHtoDAsync_v2", c_void_p(answer.data), source.address, c_size_t(source.rows.nbytes), self.handle)

    def _work(self, context: c_void_p) -> None:
        """Do the jobs. If one fails, the program continues with stale memory and its next call raises the error."""
        while True:
            job = self.jobs.get()
            try:
                if job.number == 1:
                    _cuda("cuCtxSetCurrent", context)
                _cuda("cuEventSynchronize", job.event)
                self.events.append(job.event)
                job.answer[:] = self.serve(job.rows, self.stream)
            except Exception as error:
                self.error = error
            self.done[0] = job.number

    def _slot(self, kind: str, lanes: int, columns: int, number: int | None = None) -> HostRows:
        """Return page-locked rows [lanes, columns] for the job `number`, or the newest one; every `DEPTH`-th shares them.

        Only the thread that fills the stream may allocate memory: an allocation in the worker could wait for a stream
        that waits for the worker.
        """
        key = kind, lanes, columns
        if key not in self.memory:
            self.memory[key] = [_page_locked(lanes, columns) for _ in range(DEPTH)]
        return self.memory[key][(self.number if number is None else number) % DEPTH]

    def _raise_failure(self) -> None:
        if self.error is not None:
            raise RuntimeError(f"work on the host failed: {self.error!r}") from self.error


def _page_locked(lanes: int, columns: int) -> HostRows:
    """Return new page-locked memory for rows [lanes, columns] of zeros."""
    address, count = c_void_p(), lanes * columns
    _cuda("cuMemHostAlloc", ctypes.byref(address), c_size_t(4 * count), c_uint32(PORTABLE_AND_MAPPED))
    rows = view(address.value or 0, count, ctypes.c_float).reshape(lanes, columns)
    rows[:] = 0
    return HostRows(rows, address)


def _event() -> c_void_p:
    event = c_void_p()
    _cuda("cuEventCreate", ctypes.byref(event), c_uint32(UNTIMED))
    return event
