"""Processes that do the jobs of a CUDA stream: the GPU writes rows to memory that it shares with them, and reads answers.

A job is a number of rows. Neither the thread that fills the stream nor a lock of Python takes part in one, so it costs a
few microseconds beside the work itself. The processes wait actively, so each needs a core.
"""

import mmap
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from earl_jax.options.environment import PYTHON, module_path

Serve = Callable[[np.ndarray], np.ndarray]
"""Host work: a function from float32 rows [n, k] to float32 rows [n, m]."""
DEPTH = 4
"""Largest number of jobs of a stream in progress at once; each has its own memory."""
SPAN = 1 << 24
"""A word of `Shared.asked` is a job's number modulo `SPAN`, plus `SPAN` times its layout."""
SIZE, PAGE = 1 << 30, 4096
"""Bytes of the shared memory, and of its pages. Pages that nobody writes take no memory."""
CONTROL = 3 * PAGE
"""Bytes of the words before the rows and answers."""
MOST = 128
"""Largest number of layouts, and of workers."""
ACTIVE_S, LONGEST_NAP_S = 20e-3, 5e-3
"""Seconds for which a worker waits actively, and of the longest naps with which it goes on waiting."""


def pages(size: int) -> int:
    """Return the number of pages that hold `size` bytes."""
    return -(-size // PAGE)


class Layout(NamedTuple):
    """The memory of the jobs of one shape, in whole pages: `rows [DEPTH, n, k]` and `answers [DEPTH, n, m]`."""

    number: int
    memory: np.ndarray
    rows: np.ndarray
    answers: np.ndarray


class Shared:
    """The memory of a stream and its workers; `width` is the number of columns of the answers.

    `asked [DEPTH]` holds the words that the GPU writes, `finished [1]` the number of the last job that all workers have
    done, `done [workers]` the number of the last one of each.
    """

    def __init__(self, descriptor: int, width: int):
        self.memory, self.width = np.frombuffer(mmap.mmap(descriptor, SIZE), np.uint8), width
        self.control = self.memory[:CONTROL].view(np.int32)
        lines = self.control.reshape(-1, 16)  # of a core's cache: no two sides write to the same one
        self.asked, self.finished, self.done = lines[0, :DEPTH], lines[1, :1], lines[2 : 2 + MOST, 0]
        self.shapes = lines[2 + MOST :].ravel()[: 3 * MOST].reshape(MOST, 3)
        self.layouts: dict[int, Layout] = {}

    def layout(self, number: int) -> Layout:
        """Return the layout `number`, whose first page, lanes and columns are in `shapes`."""
        if number not in self.layouts:
            page, lanes, columns = map(int, self.shapes[number])
            sizes = [DEPTH * lanes * width for width in (columns, self.width)]
            memory = self.memory[page * PAGE :][: pages(4 * sum(sizes)) * PAGE]
            numbers = memory.view(np.float32)[: sum(sizes)]
            rows, answers = (part.reshape(DEPTH, lanes, -1) for part in np.split(numbers, sizes[:1]))
            self.layouts[number] = Layout(number, memory, rows, answers)
        return self.layouts[number]

    def wait(self, number: int, pause: Callable[[], None]) -> tuple[int, Layout]:
        """Return the number and the layout of the job `number` once it is asked for, or of a later one.

        When a later job has taken its memory, the job was finished without this worker.
        """
        while True:
            word = int(self.asked[number % DEPTH])
            ahead = (word - number) % SPAN
            if ahead == 0:
                return number, self.layout(word // SPAN)
            if ahead < SPAN // 2:
                number += ahead - DEPTH + 1
            else:
                pause()


def work(shared: Shared, serve: Serve, index: int, count: int, first: int, idle: Callable[[float], None]) -> None:
    """Do the part of worker `index` of `count` in all jobs from `first` on; worker 0 also waits for the others.

    `idle` is called while there is no work, with the seconds since there was some.
    """
    number, last = first, time.perf_counter()

    def pause() -> None:
        idle(time.perf_counter() - last)

    while True:
        number, layout = shared.wait(number, pause)
        rows, answers = layout.rows[number % DEPTH], layout.answers[number % DEPTH]
        workers = min(len(rows), count)
        if index < workers:
            part = slice(len(rows) * index // workers, len(rows) * (index + 1) // workers)
            answers[part] = serve(rows[part])
            shared.done[index], last = number, time.perf_counter()
        if index == 0:
            while shared.done[:workers].min() < number:
                pause()
            shared.finished[0] = number
        number += 1


def nap(seconds: float) -> None:
    """Let others run for a moment, or for longer after many `seconds` without work."""
    time.sleep(0 if seconds < ACTIVE_S else min(seconds / 8, LONGEST_NAP_S))


class Workers:
    """Up to `count` processes that map rows to rows with `serve`, as many as the largest job has rows.

    If no process can import `serve`, a thread of this one does the jobs, more slowly. `error` says what a worker failed
    with.
    """

    def __init__(self, serve: Serve, width: int, count: int):
        self.serve, self.payload = serve, pickled(serve)
        self.count = min(count, MOST) if self.payload else 1
        self.descriptor = os.memfd_create("earl_jax")
        os.ftruncate(self.descriptor, SIZE)
        self.shared, self.end = Shared(self.descriptor, width), CONTROL // PAGE
        self.started = 0
        self.error: str | None = None

    def new_layout(self, lanes: int, columns: int, job: int) -> Layout:
        """Return memory for jobs of `lanes` rows of `columns` numbers, of which the next one, `job`, is the first."""
        number, end = len(self.shared.layouts), self.end + pages(4 * DEPTH * lanes * (columns + self.shared.width))
        if number == MOST or end * PAGE > SIZE:
            raise RuntimeError(f"no memory is left for jobs of {lanes} rows, after {number} other shapes")
        self.shared.shapes[number] = self.end, lanes, columns
        self.end = end
        while self.started < min(lanes, self.count):
            self._start(self.started, job)
            self.started += 1
        return self.shared.layout(number)

    def _start(self, index: int, job: int) -> None:
        if self.payload is None:
            return self._thread(self._work_here, job)
        arguments = os.getpid(), self.descriptor, self.shared.width, index, self.count, job
        process = subprocess.Popen(
            [*PYTHON, "-c", f"from {__name__} import main; main()", *map(str, arguments)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=[self.descriptor], start_new_session=True,
            env={**os.environ, "PYTHONPATH": module_path(), "JAX_PLATFORMS": "cpu"},
        )  # fmt: skip
        self._thread(self._watch, process)

    def _thread(self, target: Callable[..., None], *arguments: Any) -> None:
        threading.Thread(target=target, args=arguments, daemon=True).start()

    def _watch(self, process: "subprocess.Popen[bytes]") -> None:
        message, _ = process.communicate(self.payload)
        self._fail(message.decode() or f"a worker ended with code {process.returncode}")

    def _work_here(self, job: int) -> None:
        try:
            work(self.shared, self.serve, 0, 1, job, nap)
        except Exception as error:
            self._fail(repr(error))

    def _fail(self, message: str) -> None:
        """Note the error and let the GPU go on with stale memory, so that its program comes to the next job."""
        self.error = self.error or message
        while True:
            self.shared.finished[0] = np.iinfo(np.int32).max
            time.sleep(0.1)


def pickled(serve: Serve) -> bytes | None:
    """Return `serve` for another process, or None if it has parts that no other process can import."""
    try:
        payload = pickle.dumps(serve)
    except (AttributeError, TypeError, pickle.PicklingError):
        return None
    return None if b"__main__" in payload else payload


def main() -> None:
    """Work in a process that `Workers` has started, until that one ends."""
    parent, descriptor, width, index, count, first = map(int, sys.argv[1:])

    def idle(seconds: float) -> None:
        if seconds < ACTIVE_S:
            return os.sched_yield()
        if os.getppid() != parent:
            raise SystemExit
        nap(seconds)

    try:
        work(Shared(descriptor, width), pickle.load(sys.stdin.buffer), index, count, first, idle)
    except Exception as error:
        sys.stdout.write(repr(error))
