"""Work on the host inside a jitted program: it maps rows in a device's memory to new rows.

`jax.pure_callback` could do the same, but the persistent compilation cache never stores a program with a callback, each
call takes three times as long, and a GPU waits until the host has answered. It is the fallback where XLA refuses the
foreign function. XLA identifies a foreign function by its name. On a GPU, the function only queues copies and waits in
the stream, so the operations of a program between `start` and `finish` run concurrently.
"""

import functools
import itertools
import warnings
from collections.abc import Callable
from ctypes import c_int32
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import default_backend

from earl_jax.options.environment import core_count
from earl_jax.physics.host_call import callback
from earl_jax.physics.host_call.cuda import Stream, driver
from earl_jax.physics.host_call.workers import Serve, Workers
from earl_jax.physics.host_call.xla_ffi import Buffer, Frame, handler, rows_of

_SERVICES: dict[str, "Service"] = {}
_HANDLERS: dict[tuple[str, str], Any] = {}
"""The handlers that XLA calls; they must outlive every program."""


class Service:
    """Host work in one call (`step`) or in two: `start` returns a ticket for each row, `finish` the answers."""

    def __init__(self, serve: Serve, width: int):
        self.serve, self.width = serve, width
        self.answer = jax.ShapeDtypeStruct((width,), jnp.float32)
        self.numbers, self.answers = itertools.count(1), dict[int, np.ndarray]()
        self.streams: dict[int, Stream] = {}

    def step(self, rows: Buffer, answer: Buffer) -> None:
        """Write the answer at once, on a CPU."""
        rows_of(answer)[:] = self.serve(rows_of(rows))

    def start(self, rows: Buffer, tickets: Buffer) -> None:
        """Do the work and store the answer, on a CPU, where two calls save no time."""
        number = next(self.numbers) & 0x7FFFFFFF
        self.answers[number] = self.serve(rows_of(rows))
        tickets.elements(c_int32)[:] = number

    def finish(self, tickets: Buffer, answer: Buffer) -> None:
        """Write the answer that is stored for the tickets, on a CPU."""
        rows_of(answer)[:] = self.answers.pop(int(tickets.elements(c_int32)[0]))

    def stream_of(self, frame: Frame) -> Stream:
        """Return the stream of a call on a GPU, in which the work and the wait for its answer are queued."""
        stream = frame.stream
        if stream not in self.streams:
            cores = core_count() // jax.local_device_count()
            count = cores - 1 if cores > 2 else max(1, cores)  # a core for the thread that fills the stream
            self.streams[stream] = Stream(Workers(self.serve, self.width, count), stream)
        return self.streams[stream]


@functools.cache
def is_foreign() -> bool:
    """Return whether XLA takes foreign functions in this process; if it does not, warn of the cause and the costs."""
    try:
        if default_backend() != "cpu":
            jax.devices("cuda")  # an error on other accelerators, for which there is no target
            driver()
        for platform in ("cpu", "CUDA"):
            _register_target("earl_jax.probe", platform, lambda frame: None)
    except Exception as error:
        warnings.warn(
            f"XLA refuses the foreign function that calls the host ({type(error).__name__}: {error}), so "
            "jax.pure_callback calls it, with the same results: each call takes three times as long, a GPU waits for "
            "its answer, and every process compiles its programs anew",
            RuntimeWarning,
            stacklevel=2,
        )
        return False
    return True


def register(name: str, serve: Serve, width: int) -> str:
    """Register `serve`, whose answers have `width` columns, with XLA if it takes foreign functions, and return its name.

    The targets are `<name>.step` on a CPU, and `<name>.start` and `<name>.finish` on a CPU and on CUDA. If other work has
    this name, such as that of a class before a notebook defined it again, a longer one leaves it to earlier programs.
    """
    while name in _SERVICES and _SERVICES[name].serve is not serve:
        name += "_"
    if name in _SERVICES:
        return name
    service = _SERVICES[name] = Service(serve, width)
    if is_foreign():
        _register_target(f"{name}.step", "cpu", lambda frame: service.step(*frame.transfer))
        _register_target(f"{name}.start", "cpu", lambda frame: service.start(*frame.transfer))
        _register_target(f"{name}.finish", "cpu", lambda frame: service.finish(*frame.transfer))
        _register_target(f"{name}.start", "CUDA", lambda frame: service.stream_of(frame).start(*frame.transfer))
        _register_target(f"{name}.finish", "CUDA", lambda frame: service.stream_of(frame).finish(*frame.transfer))
    return name


def _register_target(target: str, platform: str, work: Callable[[Frame], None]) -> None:
    _HANDLERS[target, platform] = handler(work)
    jax.ffi.register_ffi_target(target, jax.ffi.pycapsule(_HANDLERS[target, platform]), platform=platform)


def step(name: str, row: jax.Array) -> jax.Array:
    """Return the answer [width] of service `name` to one lane's `row [k]`, read as float32; vmap makes a single call.

    The foreign function has this target on a CPU only; the callback works on all platforms.
    """
    row, service = row.astype(jnp.float32), _SERVICES[name]
    if not is_foreign():
        return callback.step(service.serve, row, service.width)
    return _call(f"{name}.step", row, service.answer)


def start(name: str, row: jax.Array) -> jax.Array:
    """Start the work on one lane's `row [k]`, read as float32, and return its ticket [1]; only if `is_foreign()`."""
    return _call(f"{name}.start", row.astype(jnp.float32), jax.ShapeDtypeStruct((1,), jnp.int32))


def finish(name: str, ticket: jax.Array) -> jax.Array:
    """Return the answer [width] to the row that `ticket` identifies."""
    return _call(f"{name}.finish", ticket, _SERVICES[name].answer)


def _call(target: str, operand: jax.Array, answer: jax.ShapeDtypeStruct) -> jax.Array:
    return jax.ffi.ffi_call(target, answer, vmap_method="broadcast_all")(operand)
