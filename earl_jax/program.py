"""One jitted program and the runs that live in it: chunks of the loop, with evaluations, logs and checkpoints between."""

import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos import Method, autonomy, birth
from earl_jax.algos.autonomy import Lives, Loop
from earl_jax.algos.mixed import together
from earl_jax.checkpoint import restore_together, save
from earl_jax.envs import Env
from earl_jax.experiment import Experiment, Row, RunFolder
from earl_jax.metrics.continuing import continuing_lane
from earl_jax.metrics.deployed import deployed_lane
from earl_jax.progress import Progress
from earl_jax.protocol import Protocol


def judge(loop: Loop, method: Method, lives: Lives) -> tuple[Lives, dict[str, jax.Array]]:
    """Return the lives with their reward window closed, and every metric [N] under both of the paper's protocols."""
    since = jnp.asarray(loop.protocol.eval_every, jnp.float32)
    step = lives.step.astype(jnp.float32)
    deployed = jax.vmap(lambda m, lane: deployed_lane(loop, m, lane, lives.step))(method, lives.lanes)
    lanes, continuing = jax.vmap(lambda lane: continuing_lane(lane, step, since))(lives.lanes)
    return lives.replace(lanes=lanes), {**deployed, **continuing, **lanes.tally.diagnostics}


_begin = jax.jit(birth.begin, static_argnames=("loop", "capacity"))
_advance = jax.jit(autonomy.run, static_argnames=("loop", "steps", "explore"), donate_argnames="lives")
_judge = jax.jit(judge, static_argnames="loop", donate_argnames="lives")


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
    """One experiment among those of a program: its `method` [n], the folder that keeps it, if any, and its rows so far."""

    experiment: Experiment
    method: Method
    folder: RunFolder | None = None
    rows: list[Row] = dataclasses.field(default_factory=list)

    def add(self, step: int, metrics: dict[str, np.ndarray]) -> list[Row]:
        """Return the rows of `metrics [n]` at `step`, written to the folder."""
        fresh = self.experiment.rows(step, metrics)
        self.rows += fresh
        if self.folder:
            self.folder.append(fresh)
        return fresh


def live(env: Env, runs: Sequence[Run], progress: bool = False) -> Lives:
    """Return the final lives of all lanes of `runs`, one after the other, carried on from their newest checkpoints.

    Runs of one program have `env`, lengths, the `form` of their methods and the step of their newest checkpoint in common.
    What each one earns is its own `rows`, and goes to its folder with the checkpoints of its own lanes.
    """
    whole, pairs = _whole(runs), list(zip(runs, _spans(runs), strict=True))
    loop, method = Loop(env, whole.protocol(env)), together([run.method for run in runs])
    chunk, warm = chunk_of(method, loop.protocol), method.sac.random_steps
    lives = _start(loop, method, runs)
    step = int(lives.step)
    for run in runs:
        run.rows = run.folder.rows_until(step) if run.folder else []
    with Progress(whole, step, show=progress) as bar:
        while step < whole.steps:
            began = time.perf_counter()
            lives = _advance(loop, method, lives, chunk, step < warm)
            lives.step.block_until_ready()
            step += chunk
            bar.advance(chunk, time.perf_counter() - began)
            if step % loop.protocol.eval_every:
                continue
            lives, metrics = _judge(loop, method, lives)
            host = {name: np.asarray(values) for name, values in metrics.items()}
            fresh = [run.add(step, {name: values[span] for name, values in host.items()}) for run, span in pairs]
            bar.report(step, list(itertools.chain(*fresh)))
            for run, span in pairs:
                if run.folder and run.experiment.checkpoint_due(step):
                    save(run.folder.checkpoints, lives, span)
    return lives


def _whole(runs: Sequence[Run]) -> Experiment:
    """Return what the runs of a program are together, for the clock and the progress bar: seeds stand for lanes."""
    algos = dict.fromkeys(run.experiment.algo for run in runs)
    lanes = range(sum(len(run.experiment.seeds) for run in runs))
    return dataclasses.replace(runs[0].experiment, algo="+".join(algos), seeds=tuple(lanes))


def _spans(runs: Sequence[Run]) -> list[slice]:
    ends = np.cumsum([len(run.experiment.seeds) for run in runs]).tolist()
    return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]


def _start(loop: Loop, method: Method, runs: Sequence[Run]) -> Lives:
    keys = jnp.concatenate([keys_of(run.experiment) for run in runs])
    capacity = birth.capacity_for(loop, method, runs[0].experiment.steps)
    fresh = functools.partial(_begin, loop, method, keys, capacity)
    folders = [run.folder.checkpoints for run in runs if run.folder]
    sizes = [len(run.experiment.seeds) for run in runs]
    if folders and (saved := restore_together(folders, sizes, jax.eval_shape(fresh))) is not None:
        return saved
    return fresh()


def keys_of(experiment: Experiment) -> jax.Array:
    """Return the PRNG keys [N] of the lives of an experiment."""
    return jax.vmap(jax.random.key)(jnp.asarray(experiment.seeds, jnp.uint32))
