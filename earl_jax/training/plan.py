"""The plan of a program: its problem, devices, memory, and the schedule of its jitted calls."""

import dataclasses
import math
from collections.abc import Hashable, Iterator, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.sharding import Mesh

from earl_jax.algos import Method
from earl_jax.envs import chosen_engine
from earl_jax.errors import InputError, brief
from earl_jax.options.schedule import require_whole_windows
from earl_jax.runs.files import warn
from earl_jax.training import memory
from earl_jax.training.demos import used_demos
from earl_jax.training.devices import lane_mesh
from earl_jax.training.state import Problem

Options = TypeVar("Options")

LONGEST_CHUNK = 1000
"""Largest number of steps in a jitted call, because signals and time limits wait for its end: half a minute for five
lanes with the paper's networks on two CPU cores."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """A program of `lanes` lanes and `steps` steps, in chunks, which are jitted calls of `chunk_steps` steps.

    `random_steps`: steps of uniformly random actions at the start; `mesh`: the devices that share the lanes, None for one
    device; `memory`: the memory that the program needs.
    """

    problem: Problem
    lanes: int
    steps: int
    chunk_steps: int
    random_steps: int
    mesh: Mesh | None
    memory: memory.MemoryEstimate

    @property
    def engine(self) -> str:
        """The name of the task's physics engine, with which a `Program` has replaced `auto`, or `kinematic`."""
        return chosen_engine(self.problem.env)


def make_plan(problem: Problem, method: Method, lanes: int, steps: int, devices: int | None = None) -> Plan:
    """Return the plan of a program with `lanes` lanes on `devices` devices, as in `lane_mesh`.

    A `RunWarning` is issued if the method does not learn within `steps`, if chunks make its refreshes more frequent, or
    if options have no effect.

    Raises:
        ValueError: `steps` is not a multiple of the protocol's `eval_every`, the task lacks demonstrations that the
            method needs, the lanes can't be divided over the devices, or the program does not fit into their memory.
    """
    every = problem.protocol.eval_every
    require_whole_windows(steps, every)
    random = method.learner.random_steps
    common = math.gcd(random, every)
    chunk = max(size for size in range(1, min(common, LONGEST_CHUNK) + 1) if common % size == 0)
    for surprise in _surprises(problem, method, steps, chunk):
        warn(surprise)
    mesh, need = lane_mesh(devices, lanes), memory.estimate(problem, method, lanes, steps)
    memory.require(need, mesh)
    return Plan(problem, lanes, steps, chunk_steps=chunk, random_steps=random, mesh=mesh, memory=need)


def _surprises(problem: Problem, method: Method, steps: int, chunk: int) -> Iterator[str]:
    """Yield what a user may not expect of a run of `steps` steps, in chunks of `chunk` steps."""
    learner, every, refresh = method.learner, problem.protocol.eval_every, method.refresh_every
    random = learner.random_steps
    if random >= steps:
        yield f"nothing is learnt: random_steps is {random:,}, and the run has only {steps:,} steps"
    elif refresh and chunk % refresh:
        yield (
            f"{method.name} refreshes every {math.gcd(chunk, refresh):,} steps, not every {refresh:,}: refresh_every does not "
            f"divide the {chunk:,} steps of a chunk, which divide random_steps {random:,} and eval_every {every:,}"
        )
    unused = [
        name for name in ("demo_share", "all_demos", "keep_demos", "cloning") if _is_positive(getattr(learner, name))
    ]
    if unused and not used_demos(problem.env, method):
        names, where = " and ".join(unused), f"{method.name} has no demonstrations on {problem.env.name}"
        yield f"{names} without effect: {where}"
    yield from _unused(method, type(method))
    yield from _unused(learner, type(method).learner)


def _unused(options: Any, preset: Any) -> Iterator[str]:
    """Yield a warning for each field that differs from `preset`, or its default, though another field disables it."""
    for field in dataclasses.fields(options):
        value, default = getattr(options, field.name), getattr(preset, field.name, field.default)
        for name, off in field.metadata.get("unless", {}).items():
            is_known = value is not None and not isinstance(value, Tracer)
            if is_known and not _all_equal(value, default) and _all_equal(getattr(options, name), off):
                yield f"{field.name} without effect: {name} is {off}"


def _is_positive(option: Any) -> bool:
    """Return whether an `option` is given and positive in any lane; False if it is traced."""
    return option is not None and not isinstance(option, Tracer) and np.max(option) > 0


def _all_equal(option: Any, value: Any) -> bool:
    """Return whether an `option` has the `value` in all lanes, up to float32 rounding; False if it is traced."""
    if isinstance(option, Tracer) or option is None or value is None:
        return option is value
    return np.allclose(option, value, rtol=1e-6, atol=0.0)


def per_lane(options: Options, lanes: int) -> Options:
    """Return a method or a learner with every float leaf broadcast to [lanes]; a leaf of that shape keeps its values.

    Raises:
        ValueError: a leaf is text, a constant of `Method`, or neither a scalar nor of length `lanes`; the message names it.
    """

    def broadcast(path, leaf):
        name = jax.tree_util.keystr(path, simple=True, separator=".").removeprefix("learner.")
        if isinstance(leaf, str) or name in vars(Method):
            fix = f"`{name}: {type(leaf).__name__} = flax.struct.field(pytree_node=False, default=...)`"
            raise InputError(f"{name} is {brief(leaf)}, not a number that can vary by lane; mark the field: {fix}")
        shape = jnp.shape(leaf)
        if shape not in ((), (lanes,)):
            raise InputError(f"{name} has shape {shape}; pass one value, or one for each of {lanes} lanes")
        dtype = jnp.bool_ if jnp.issubdtype(jnp.result_type(leaf), jnp.bool_) else jnp.float32
        return jnp.broadcast_to(jnp.asarray(leaf, dtype), (lanes,))

    return jax.tree_util.tree_map_with_path(broadcast, options)


def program_structure(method: Method) -> Hashable:
    """Return what the methods of one program must share: the class, and all options that are not floats or bools."""
    return type(method), jax.tree.structure(method)


def join_lanes(methods: Sequence[Method]) -> Method:
    """Return one method for the lanes of all `methods`, in their order; every leaf has a leading lane axis.

    Raises:
        ValueError: the methods differ in their class or in an option that is fixed when a program is compiled.
    """
    if len(set(map(program_structure, methods))) > 1:
        names = ", ".join(sorted({method.name for method in methods}))
        raise InputError(
            f"the lanes of a program must have one method, which differs in float and bool options alone: {names}"
        )
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *methods)
