"""One jitted program and the runs that live in it: chunks of the loop, with evaluations, logs and checkpoints between."""

import contextlib
import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from earl_jax import memory
from earl_jax.algos import Method, autonomy, birth
from earl_jax.algos.life import Lives, Loop
from earl_jax.algos.mixed import together
from earl_jax.cache import keep_programs
from earl_jax.checkpoint import restore_together, save
from earl_jax.devices import LANES, LIVES, first_host, gathered, lane_mesh, mapped, placed
from earl_jax.envs import Env
from earl_jax.experiment import Experiment, Row, RunFolder
from earl_jax.logs import Log, opened
from earl_jax.metrics.continuing import continuing_lane
from earl_jax.metrics.deployed import deployed_lane
from earl_jax.progress import Progress
from earl_jax.protocol import Protocol, Rules


def judge(loop: Loop, method: Method, lives: Lives) -> tuple[Lives, dict[str, jax.Array]]:
    """Return the lives with their reward window closed, and every metric [N] under both of the paper's protocols."""
    since = jnp.asarray(loop.protocol.eval_every, jnp.float32)
    step = lives.step.astype(jnp.float32)
    deployed = jax.vmap(lambda m, lane: deployed_lane(loop, m, lane, lives.step))(method, lives.lanes)
    lanes, continuing = jax.vmap(lambda lane: continuing_lane(lane, step, since))(lives.lanes)
    return lives.replace(lanes=lanes), {**deployed, **continuing, **lanes.tally.diagnostics}


@functools.partial(jax.jit, static_argnames=("loop", "capacity", "mesh"))
def _begin(loop: Loop, method: Method, keys: jax.Array, rules: Rules, capacity: int, mesh: Mesh | None) -> Lives:
    begin = mapped(lambda m, k, r: birth.begin(loop, m, k, capacity, r), mesh, (LANES, LANES, LANES), LIVES)
    return begin(method, keys, rules)


@functools.partial(jax.jit, static_argnames=("loop", "steps", "explore", "mesh"), donate_argnames="lives")
def _advance(loop: Loop, method: Method, lives: Lives, steps: int, explore: bool, mesh: Mesh | None) -> Lives:
    run = mapped(lambda m, state: autonomy.run(loop, m, state, steps, explore), mesh, (LANES, LIVES), LIVES)
    return run(method, lives)


@functools.partial(jax.jit, static_argnames=("loop", "mesh"), donate_argnames="lives")
def _judge(loop: Loop, method: Method, lives: Lives, mesh: Mesh | None) -> tuple[Lives, dict[str, jax.Array]]:
    return mapped(functools.partial(judge, loop), mesh, (LANES, LIVES), (LIVES, LANES))(method, lives)


def per_lane(method: Method, lanes: int) -> Method:
    """Return `method` with every float leaf as an array [lanes]; a leaf that is one already keeps its values.

    Raises:
        ValueError: a leaf is neither a scalar nor of length `lanes`.
    """

    def spread(leaf):
        shape = jnp.shape(leaf)
        if shape not in ((), (lanes,)):
            raise ValueError(f"a hyper-parameter has shape {shape}; give one value, or one for each of {lanes} lanes")
        dtype = jnp.bool_ if jnp.issubdtype(jnp.result_type(leaf), jnp.bool_) else jnp.float32
        return jnp.broadcast_to(jnp.asarray(leaf, dtype), (lanes,))

    return jax.tree.map(spread, method)


def chunk_of(method: Method, protocol: Protocol) -> int:
    """Return the steps of one jitted call: as many as fit both the random start and the evaluations."""
    return math.gcd(method.sac.random_steps, protocol.eval_every)


@dataclasses.dataclass
class Run:
    """One experiment among those of a program: its `method` [n], the folder that keeps it and who else listens, if any, and
    its rows so far."""

    experiment: Experiment
    method: Method
    folder: RunFolder | None = None
    listeners: Sequence[Log] = ()
    rows: list[Row] = dataclasses.field(default_factory=list)

    @contextlib.contextmanager
    def logged(self, step: int) -> Iterator[None]:
        """Open the logs of this run, which has lived `step` steps; what was logged later will be logged again."""
        self.rows = self.folder.rows_until(step) if self.folder and first_host() else []
        lives_on = step < self.experiment.steps and first_host()
        self._logs = opened(self.folder, self.listeners, step) if lives_on else []
        try:
            yield
        finally:
            for log in self._logs:
                log.close()

    def add(self, step: int, metrics: dict[str, np.ndarray]) -> list[Row]:
        """Return the rows of `metrics [n]` at `step`, which every log is told of."""
        fresh = self.experiment.rows(step, metrics)
        self.rows += fresh
        for log in self._logs:
            log.log(step, metrics)
        return fresh


def live(env: Env, runs: Sequence[Run], progress: bool = False, devices: int | None = None) -> Lives:
    """Return the final lives of all lanes of `runs`, one after the other, carried on from their newest checkpoints.

    Runs of one program have `env`, lengths, the `form` of their methods and the step of their newest checkpoint in common;
    rules of their worlds (H_T, settings) may differ, since lanes carry them as data.
    What each one earns is its own `rows`, and goes to its folder with the checkpoints of its own lanes.
    """
    keep_programs()
    whole, pairs = _whole(runs), list(zip(runs, _spans(runs), strict=True))
    method = together([run.method for run in runs])
    loop, mesh, needed = fitting(env, method, whole, devices)
    method, chunk, warm = placed(method, mesh), chunk_of(method, loop.protocol), method.sac.random_steps
    lives = _start(loop, method, runs, mesh)
    step = int(gathered(lives.step))
    with contextlib.ExitStack() as stack:
        for run in runs:
            stack.enter_context(run.logged(step))
        bar = stack.enter_context(Progress(whole, step, show=progress and first_host()))
        bar.say(str(needed))
        while step < whole.steps:
            began = time.perf_counter()
            lives = _advance(loop, method, lives, chunk, step < warm, mesh)
            lives.step.block_until_ready()
            step += chunk
            bar.advance(chunk, time.perf_counter() - began)
            if step % loop.protocol.eval_every:
                continue
            lives, metrics = _judge(loop, method, lives, mesh)
            host = gathered(metrics)
            fresh = [run.add(step, {name: values[span] for name, values in host.items()}) for run, span in pairs]
            bar.report(step, list(itertools.chain(*fresh)))
            for run, span in pairs:
                if run.folder and run.experiment.checkpoint_due(step):
                    save(run.folder.checkpoints, lives, span)
    return lives


def fitting(env: Env, method: Method, whole: Experiment, devices: int | None) -> tuple[Loop, Mesh | None, memory.Need]:
    """Return the world of a program, the devices for its lanes and what they will occupy.

    Raises:
        ValueError: a task lacks the demonstrations that a method needs, or lanes and devices don't fit.
    """
    lanes = len(whole.seeds)
    loop, mesh = Loop(env.for_lanes(lanes), whole.protocol(env)), lane_mesh(devices, lanes)
    needed = memory.need(loop, method, lanes, whole.steps)
    memory.require(needed, mesh)
    return loop, mesh, needed


def _whole(runs: Sequence[Run]) -> Experiment:
    """Return what the runs of a program are together, for the clock and the progress bar: seeds stand for lanes."""
    algos = dict.fromkeys(run.experiment.algo for run in runs)
    lanes = range(sum(len(run.experiment.seeds) for run in runs))
    return dataclasses.replace(runs[0].experiment, algo="+".join(algos), seeds=tuple(lanes))


def _spans(runs: Sequence[Run]) -> list[slice]:
    ends = np.cumsum([len(run.experiment.seeds) for run in runs]).tolist()
    return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]


def _start(loop: Loop, method: Method, runs: Sequence[Run], mesh: Mesh | None) -> Lives:
    keys = placed(jnp.concatenate([keys_of(run.experiment) for run in runs]), mesh)
    rules = placed(jax.tree.map(lambda *each: jnp.concatenate(each), *map(_rules_of, runs)), mesh)
    capacity = birth.capacity_for(loop, method, runs[0].experiment.steps)
    fresh = functools.partial(_begin, loop, method, keys, rules, capacity, mesh)
    folders = [run.folder.checkpoints for run in runs if run.folder]
    sizes = [len(run.experiment.seeds) for run in runs]
    if folders and (saved := restore_together(folders, sizes, jax.eval_shape(fresh))) is not None:
        return placed(saved, mesh, LIVES)
    return fresh()


def _rules_of(run: Run) -> Rules:
    """Return the rules of a run's lanes, leaves [n]."""
    experiment = run.experiment
    rules = experiment.protocol(experiment.build_env()).rules
    return jax.tree.map(lambda rule: jnp.full(len(experiment.seeds), rule), rules)


def keys_of(experiment: Experiment) -> jax.Array:
    """Return the PRNG keys [N] of the lives of an experiment."""
    return jax.vmap(jax.random.key)(jnp.asarray(experiment.seeds, jnp.uint32))
