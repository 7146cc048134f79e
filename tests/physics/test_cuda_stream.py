"""Jobs in a CUDA stream, with a driver in Python that does at once what a stream does in order."""

import ctypes
from ctypes import c_int32, c_int64
from types import SimpleNamespace

import numpy as np
import pytest

from earl_jax.physics.host_call import cuda
from earl_jax.physics.host_call.workers import Workers
from earl_jax.physics.host_call.xla_ffi import Buffer
from tests.physics.host_work import double, refuse, wait_for

COLUMNS, WIDTH = 4, 2


def copy(target, source, size, _):
    ctypes.memmove(target.value, source.value, size.value)
    return 0


def fill(address, value, count, _):
    np.ctypeslib.as_array((c_int32 * count.value).from_address(address.value))[:] = value
    return 0


def write(_, address, value, flags):
    c_int32.from_address(address.value).value = value.value
    return int(flags.value != cuda.SYSTEM_WIDE)


def wait(_, address, value, flags):
    wait_for(lambda: c_int32.from_address(address.value).value >= value.value)
    return int(flags.value != cuda.AT_LEAST)


@pytest.fixture(autouse=True)
def driver(monkeypatch):
    """The functions of libcuda that a stream of jobs calls."""
    copies = {"cuMemcpyDtoHAsync_v2": copy, "cuMemcpyHtoDAsync_v2": copy, "cuMemHostRegister_v2": lambda *_: 0}
    words = {"cuMemsetD32Async": fill, "cuStreamWriteValue32_v2": write, "cuStreamWaitValue32_v2": wait}
    fake = SimpleNamespace(**copies, **words)
    assert vars(fake).keys() == set(cuda.FUNCTIONS)
    monkeypatch.setattr(cuda, "driver", lambda: fake)
    return fake


def buffer(array):
    """Return `array` as XLA passes it; the array must outlive the buffer."""
    dims = (c_int64 * array.ndim)(*array.shape)
    result = Buffer(data=array.ctypes.data, rank=array.ndim, dims=ctypes.cast(dims, ctypes.POINTER(c_int64)))
    result.kept = dims
    return result


class Call:
    """One control step: the rows that the stream holds, its tickets and its answer."""

    def __init__(self, value, lanes=(3,)):
        self.rows = np.full((*lanes, COLUMNS), value, np.float32)
        self.tickets, self.answer = np.zeros((*lanes, 1), np.int32), np.zeros((*lanes, WIDTH), np.float32)

    def start(self, stream):
        stream.start(buffer(self.rows), buffer(self.tickets))

    def finish(self, stream):
        stream.finish(buffer(self.tickets), buffer(self.answer))


def stream_of(serve):
    """Return a stream whose jobs a thread does, as no process can import a function of a function."""
    return cuda.Stream(Workers(lambda rows: serve(rows), WIDTH, 2), 7)


def test_jobs_are_answered_in_any_order_and_memory_is_reused():
    stream = stream_of(double)
    for first in range(0, 6 * cuda.DEPTH, 2):
        calls = [Call(first), Call(first + 1)]
        for call in calls:
            call.start(stream)
        np.testing.assert_array_equal(calls[1].tickets, first + 2)
        for call in reversed(calls):
            call.finish(stream)
        np.testing.assert_array_equal(calls[0].answer, 2 * first)
        np.testing.assert_array_equal(calls[1].answer, 2 * first + 2)


def test_the_answer_is_found_if_xla_has_moved_the_tickets_of_the_only_job():
    stream, call = stream_of(double), Call(5)
    call.start(stream)
    call.tickets = call.tickets.copy()
    call.finish(stream)
    np.testing.assert_array_equal(call.answer, 10)
    with pytest.raises(RuntimeError, match="0 control steps are in progress, but none has these tickets"):
        call.finish(stream)


def test_a_job_that_is_in_progress_for_too_long_is_an_error():
    stream, calls = stream_of(double), [Call(value) for value in range(cuda.DEPTH + 1)]
    for call in calls[:-1]:
        call.start(stream)
        if call is not calls[0]:
            call.finish(stream)
    with pytest.raises(RuntimeError, match=f"not finished before the {cuda.DEPTH}th after it, which"):
        calls[-1].start(stream)
    calls[-1].start(stream)
    calls[-1].finish(stream)
    np.testing.assert_array_equal(calls[-1].answer, 2 * cuda.DEPTH)


def test_jobs_of_other_axes_share_the_memory_of_jobs_with_as_many_rows(driver):
    stream, locked = stream_of(double), []
    driver.cuMemHostRegister_v2 = lambda address, *_: locked.append(address.value) or 0
    for shape in ((6,), (2, 3), (6,), (3, 2), (2, 2)):
        call = Call(5, shape)
        call.start(stream)
        call.finish(stream)
        np.testing.assert_array_equal(call.answer, 10)
    assert len(locked) == len(set(locked)) == 2


def test_a_failed_job_does_not_block_the_stream_and_is_raised_by_the_next_call():
    stream, call = stream_of(refuse), Call(1)
    call.start(stream)
    call.finish(stream)
    with pytest.raises(RuntimeError, match="work on the host failed: ValueError"):
        Call(2).start(stream)


def test_an_error_of_the_driver_names_the_function(driver):
    driver.cuStreamWriteValue32_v2 = lambda *_: 700
    stream = stream_of(double)
    with pytest.raises(RuntimeError, match="cuStreamWriteValue32_v2 failed with CUDA error 700"):
        Call(1).start(stream)
