"""Host work inside a CUDA stream: copies, words and waits are queued in the stream, and worker processes do the work.

`cuLaunchHostFunc` wakes a sleeping thread instead, which took 0.3 ms per control step on a virtual machine.
"""

import ctypes
import functools
import math
from ctypes import c_size_t, c_uint32, c_void_p
from typing import Any, NamedTuple

import numpy as np

from earl_jax.physics.host_call.workers import DEPTH, SPAN, Workers
from earl_jax.physics.host_call.xla_ffi import Buffer

PORTABLE_AND_MAPPED, SYSTEM_WIDE, AT_LEAST = 3, 0, 0
"""CUDA's flags for host memory that is portable and mapped, for a word that is written after all that precedes it, and
for a wait until a word is at least a value."""
FUNCTIONS = (
    "cuMemHostRegister_v2", "cuMemcpyDtoHAsync_v2", "cuMemcpyHtoDAsync_v2", "cuMemsetD32Async",
    "cuStreamWriteValue32_v2", "cuStreamWaitValue32_v2",
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


class Slot(NamedTuple):
    """The memory of one job: the addresses and bytes of its rows and of its answers, and the number of its layout."""

    rows: c_void_p
    rows_size: c_size_t
    answers: c_void_p
    answers_size: c_size_t
    layout: int


class Stream:
    """The jobs of one stream, which `workers` do in order.

    The thread of XLA that fills the stream runs this code for each control step, and a GPU waits for a late one, so
    it allocates and looks up nothing twice.
    """

    def __init__(self, workers: Workers, stream: int):
        self.workers, self.handle = workers, c_void_p(stream)
        self.number, self.in_progress = 0, dict[int, tuple[int, Slot]]()
        self.slots = dict[tuple[int, int], list[Slot]]()
        shared = workers.shared
        _lock_pages(shared.control)
        self.asked = [_address(shared.asked[slot:]) for slot in range(DEPTH)]
        self.finished = _address(shared.finished)

    def start(self, rows: Buffer, tickets: Buffer) -> None:
        """Queue a job, which the workers start when the stream has written `rows`."""
        self._raise_failure()
        number = self.number + 1
        address, (oldest, _) = next(iter(self.in_progress.items()), (0, (number, None)))
        if number - oldest >= DEPTH:
            del self.in_progress[address]  # if an error ended its program, the next one works
            raise RuntimeError(f"a control step is not finished before the {DEPTH}th after it, which needs its memory")
        slot = self._slot(rows, number)
        self.number = number
        self.in_progress[tickets.data or 0] = number, slot
        _cuda("cuMemcpyDtoHAsync_v2", slot.rows, c_void_p(rows.data), slot.rows_size, self.handle)
        _cuda("cuMemsetD32Async", c_void_p(tickets.data), number, c_size_t(tickets.count), self.handle)
        word = c_uint32(number % SPAN + SPAN * slot.layout)
        _cuda("cuStreamWriteValue32_v2", self.handle, self.asked[number % DEPTH], word, c_uint32(SYSTEM_WIDE))

    def finish(self, tickets: Buffer, answer: Buffer) -> None:
        """Make the stream wait for the job of these `tickets` and copy its answer.

        XLA may have moved the tickets in memory; they are still recognised if no other job is in progress.
        """
        self._raise_failure()
        address = tickets.data if tickets.data in self.in_progress else next(iter(self.in_progress), None)
        if address is None or (address != tickets.data and len(self.in_progress) > 1):
            raise RuntimeError(f"{len(self.in_progress)} control steps are in progress, but none has these tickets")
        number, slot = self.in_progress.pop(address)
        _cuda("cuStreamWaitValue32_v2", self.handle, self.finished, c_uint32(number), c_uint32(AT_LEAST))
        _cuda("cuMemcpyHtoDAsync_v2", c_void_p(answer.data), slot.answers, slot.answers_size, self.handle)

    def _slot(self, rows: Buffer, number: int) -> Slot:
        """Return the memory for the job `number`; every `DEPTH`-th one of its shape shares it."""
        *lanes, columns = rows.shape
        shape = math.prod(lanes), columns
        if shape not in self.slots:
            layout = self.workers.new_layout(*shape, number)
            _lock_pages(layout.memory)
            self.slots[shape] = [
                Slot(_address(given), c_size_t(given.nbytes), _address(answer), c_size_t(answer.nbytes), layout.number)
                for given, answer in zip(layout.rows, layout.answers, strict=True)
            ]
        return self.slots[shape][number % DEPTH]

    def _raise_failure(self) -> None:
        if self.workers.error is not None:
            raise RuntimeError(f"work on the host failed: {self.workers.error}")


def _address(array: np.ndarray) -> c_void_p:
    return c_void_p(array.ctypes.data)


def _lock_pages(memory: np.ndarray) -> None:
    """Let the GPU read and write `memory` of whole pages."""
    _cuda("cuMemHostRegister_v2", _address(memory), c_size_t(memory.nbytes), c_uint32(PORTABLE_AND_MAPPED))
