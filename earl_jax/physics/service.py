"""Work on the host inside a jitted program: rows of a device's memory in, rows out.

`jax.pure_callback` would do the same, but a program that holds one is never kept by the persistent compilation cache, takes
three times as long a call and stops a GPU until the host has answered. A foreign function is known to XLA by its name, and on a
GPU it only puts its copies and waits into the stream: what a program does between `launch` and `land` runs meanwhile.
"""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.physics.cuda import Stream
from earl_jax.physics.xla import Frame, handler, rows_of

Serve = Callable[[np.ndarray, int], np.ndarray]
"""Host work: float32 rows [n, k] and the stream they come from (0 on a CPU) in, float32 rows [n, m] out."""
TICKET = jax.ShapeDtypeStruct((1,), jnp.int32)
_SERVICES: dict[str, "Service"] = {}
_KEPT: dict[tuple[str, str], Any] = {}
"""Handlers that XLA knows, which must outlive every program."""


class Service:
    """Host work as a whole or in two halves: `launch` takes rows and gives each a ticket, `land` trades them for the answer."""

    def __init__(self, serve: Serve, width: int):
        self.serve, self.width = serve, width
        self.numbers, self.answers = itertools.count(1), dict[int, np.ndarray]()
        self.streams: dict[int, Stream] = {}

    def step(self, frame: Frame) -> None:
        """Answer at once, on a CPU."""
        rows, answer = frame.transfer
        rows_of(answer)[:] = self.serve(rows_of(rows), 0)

    def launch(self, frame: Frame) -> None:
        """Do the work and keep the answer, on a CPU, where nothing is gained by two halves."""
        rows, tickets = frame.transfer
        number = next(self.numbers) & 0x7FFFFFFF
        self.answers[number] = self.serve(rows_of(rows), 0)
        tickets.integers[:] = number

    def land(self, frame: Frame) -> None:
        """Hand out the answer that was kept for the tickets, on a CPU."""
        tickets, answer = frame.transfer
        rows_of(answer)[:] = self.answers.pop(int(tickets.integers[0]))

    def launch_in_stream(self, frame: Frame) -> None:
        """Begin the work once the rows are there, on a GPU."""
        self._stream(frame).launch(*frame.transfer)

    def land_in_stream(self, frame: Frame) -> None:
        """Hand out the answer once it is there, on a GPU."""
        self._stream(frame).land(*frame.transfer)

    def _stream(self, frame: Frame) -> Stream:
        stream = frame.stream
        if stream not in self.streams:
            self.streams[stream] = Stream(self.serve, self.width, stream)
        return self.streams[stream]


def register(name: str, serve: Serve, width: int) -> None:
    """Make `serve`, whose answers are `width` wide, known to XLA from now on.

    It is `<name>.step` on a CPU, and `<name>.launch` and `<name>.land` on a CPU and on CUDA.
    """
    known = name in _SERVICES
    if not known or _SERVICES[name].serve is not serve:
        _SERVICES[name] = Service(serve, width)
    if known:
        return
    targets = {
        ("step", "cpu"): Service.step,
        ("launch", "cpu"): Service.launch,
        ("land", "cpu"): Service.land,
        ("launch", "CUDA"): Service.launch_in_stream,
        ("land", "CUDA"): Service.land_in_stream,
    }
    for (part, platform), work in targets.items():
        target = handler(lambda frame, work=work: work(_SERVICES[name], frame))
        _KEPT[f"{name}.{part}", platform] = target
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
