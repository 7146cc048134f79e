"""Seeds in, curves out: training by name, from a run folder, or as one pure function."""

import contextlib
import dataclasses
import functools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos import Method, autonomy, birth, method_for
from earl_jax.algos.life import Lane, Lives, Loop
from earl_jax.checkpoint import restore
from earl_jax.devices import first_host
from earl_jax.envs import Env, make
from earl_jax.experiment import Experiment, RunFolder
from earl_jax.logs import Log, check
from earl_jax.metrics.judgement import Judgement, judged
from earl_jax.policy import Policy
from earl_jax.program import Run, chunk_of, fitting, judge, keys_of, live, per_lane
from earl_jax.protocol import SETTINGS, Deployment, Setting, setting_of, settled


def lifetime(loop: Loop, method: Method, keys: jax.Array, steps: int) -> tuple[Lives, dict[str, jax.Array]]:
    """Return final lives and metrics [N, E] of whole lives of `steps`, as one pure function for jit, vmap or a notebook.

    Args:
        loop: the world and its protocol (static).
        method: the method, scalar leaves or [N].
        keys: typed PRNG keys [N], one a seed.
        steps: training steps, a multiple of the protocol's `eval_every`.

    Raises:
        ValueError: the numbers don't fit together.
    """
    every, method = loop.protocol.eval_every, per_lane(method, keys.shape[0])
    if steps < 1 or steps % every:
        raise ValueError(f"steps {steps} is not a multiple of eval_every {every}")
    chunk = chunk_of(method, loop.protocol)
    warm = min(method.sac.random_steps, steps)
    lives = birth.begin(loop, method, keys, birth.capacity_for(loop, method, steps))

    def part(carry, start, stop):
        for begin, end, explore in _segments(start, stop, warm):
            carry = _scan_chunks(loop, method, carry, (end - begin) // chunk, chunk, explore)
        return judge(loop, method, carry)

    first = -(-warm // every) * every
    early = []
    for start in range(0, first, every):
        lives, metrics = part(lives, start, start + every)
        early.append(metrics)
    lives, rest = jax.lax.scan(
        lambda carry, _: part(carry, first, first + every), lives, length=(steps - first) // every
    )
    curves = [jax.tree.map(lambda *rows: jnp.stack(rows), *early)] * bool(early) + [rest]
    return lives, jax.tree.map(lambda *parts: jnp.concatenate(parts).T, *curves)


def _scan_chunks(loop: Loop, method: Method, lives: Lives, count: int, chunk: int, explore: bool) -> Lives:
    def body(carry, _):
        return autonomy.run(loop, method, carry, chunk, explore), None

    return jax.lax.scan(body, lives, length=count)[0]


def _segments(start: int, stop: int, warm: int) -> Iterable[tuple[int, int, bool]]:
    """Yield the spans of start to stop that are explored (before step `warm`) and learnt in."""
    middle = min(max(warm, start), stop)
    return [(a, b, explore) for a, b, explore in ((start, middle, True), (middle, stop, False)) if a < b]


@dataclasses.dataclass
class Result:
    """What training returns: `steps [E]`, `metrics` of arrays [N, E], the final `lives` of N `seeds`."""

    experiment: Experiment
    env: Env
    method: Method
    seeds: tuple[int, ...]
    steps: np.ndarray
    metrics: dict[str, np.ndarray]
    lives: Lives

    @property
    def judgement(self) -> Judgement:
        """What the lives were worth: J_D, D(A), C(A)."""
        return judged(self.steps, self.metrics, self.experiment.deployed_metric)

    def policy(self, seed: int = 0) -> Policy:
        """Return the greedy task policy of the `seed`-th lane, callable on obs [..., o]."""
        return Policy.of(self.env, select_seed(self.method, seed), select_seed(self.lives, seed))


def select_seed(state: Any, i: int) -> Any:
    """Return lane `i` of `state`: a `Lane` out of `Lives`, or any tree of arrays with a leading lane axis.

    Raises:
        IndexError: there is no such lane.
    """
    lanes = state.lanes if isinstance(state, Lives) else state
    count = jax.tree.leaves(lanes)[0].shape[0]
    if not -count <= i < count:
        raise IndexError(f"no lane {i}: there are {count}")
    return jax.tree.map(lambda leaf: leaf[i], lanes)


def train(
    env: str | Env,
    algo: str | Method,
    *,
    setting: str | Setting = Deployment.name,
    seeds: int | Sequence[int] = 5,
    steps: int = 100_000,
    eval_every: int = 10_000,
    eval_episodes: int = 10,
    out: str | Path | None = None,
    checkpoint_every: int = 100_000,
    logs: Sequence[str | Log] = (),
    progress: bool = False,
    devices: int | None = None,
    **options: Any,
) -> Result:
    """Return the curves and final lives of `algo` on `env`, all seeds in one jitted program.

    Args:
        env: a name of `list_envs()` or an `Env`.
        algo: a name of `list_algos()`, with its hyper-parameters in `options`, or a `Method`.
        setting: `deployment`, `continuing`, or one of their objects with its own interventions and budget (`protocol`).
        seeds: how many seeds (0, 1, ...) or which.
        steps: training steps of each seed.
        eval_every: steps between evaluations; the last one is at `steps`.
        eval_episodes: greedy episodes of each deployed evaluation.
        out: a folder for config, metrics and checkpoints; without it nothing is written.
        checkpoint_every: steps between checkpoints, where `out` is given.
        logs: where metrics go besides metrics.csv: `tensorboard` or `wandb` (kept in `out`), or an object with `log` and `close`.
        progress: show a bar, or on a plain stream a line per evaluation.
        devices: how many devices share the lanes; one, or those of all hosts where jax runs on several.
        options: hyper-parameters by name; a list gives each lane its own value.

    Raises:
        ValueError: an unknown name or option, or numbers that don't fit together; the message says which.
    """
    setting = setting_of(setting) if isinstance(setting, str) else setting
    task, setting = settled(make(env) if isinstance(env, str) else env, setting)
    env = setting.world(task)
    method = method_for(env, algo, **options) if isinstance(algo, str) else _with_options(algo, options)
    which = tuple(range(seeds)) if isinstance(seeds, int) else tuple(int(seed) for seed in seeds)
    experiment = Experiment.of(env, method, which, steps, eval_every, eval_episodes, checkpoint_every, setting)
    fitting(env, method, experiment, devices)  # before there is a folder
    folder = _folder(out, experiment, logs)
    listeners = [log for log in logs if not isinstance(log, str)]
    return execute(experiment, folder, env=env, method=method, listeners=listeners, progress=progress, devices=devices)


def _folder(out: str | Path | None, experiment: Experiment, logs: Sequence[str | Log]) -> RunFolder | None:
    """Return the new folder of a run, if it is to have one; logs that can't be are found out before."""
    check(logs)
    names = tuple(log for log in logs if isinstance(log, str))
    if out is None:
        if names:
            raise ValueError(f"the log {names[0]} writes into a run folder: name one with out=")
        return None
    path = Path(out)
    return RunFolder.create(path, experiment, names) if first_host() else RunFolder(path, experiment, names)


def split_options(env: str, options: dict[str, Any]) -> tuple[Env, Setting, dict[str, Any]]:
    """Return the world of the task `env`, its setting (`setting=NAME` among them) and the method's options, out of `options`.

    Raises:
        ValueError: an unknown task or setting, or options of theirs that don't fit.
    """
    rest = dict(options)
    name = rest.pop("setting", Deployment.name)
    known = {field.name for field in dataclasses.fields(setting_of(name))}
    asked = {option: rest.pop(option) for option in list(rest) if option in known}
    for other, setting in SETTINGS.items():
        strays = {field.name for field in dataclasses.fields(setting)} & set(rest)
        if strays:
            raise ValueError(f"{strays.pop()} is an option of the setting {other!r}, and this is {name!r}")
    fields = {field.name for field in dataclasses.fields(make(env))}
    task = make(env, **{option: rest.pop(option) for option in list(rest) if option in fields})
    setting = setting_of(name, **asked)
    return setting.world(task), setting, rest


def _with_options(method: Method, options: dict[str, Any]) -> Method:
    if options:
        raise ValueError(f"options {', '.join(options)} go with an algo's name; this one is built: use .replace(...)")
    return method


def execute(
    experiment: Experiment,
    folder: RunFolder | None = None,
    *,
    env: Env | None = None,
    method: Method | None = None,
    listeners: Sequence[Log] = (),
    progress: bool = False,
    devices: int | None = None,
) -> Result:
    """Return the result of `experiment`, carried on from the newest whole checkpoint in `folder` where there is one."""
    env, method = env or experiment.build_env(), method or experiment.build_method()
    run = Run(experiment, per_lane(method, len(experiment.seeds)), folder, listeners)
    with folder.claimed() if folder else contextlib.nullcontext():
        lives = live(env, [run], progress, devices)
    return Result(experiment, env, run.method, experiment.seeds, *experiment.curves(run.rows), lives)


def load_lanes(folder: RunFolder) -> tuple[Env, Method, Lane]:
    """Return the env, method [N] and lanes [N] of a run folder's newest checkpoint.

    Raises:
        ValueError: the folder has no checkpoint yet, or a damaged one.
    """
    experiment = folder.experiment
    env, method = experiment.build_env(), per_lane(experiment.build_method(), len(experiment.seeds))
    loop = Loop(env, experiment.protocol(env))
    capacity = birth.capacity_for(loop, method, 1)
    shape = jax.eval_shape(functools.partial(birth.begin, loop, method, keys_of(experiment), capacity))
    lives = restore(folder.checkpoints, shape, with_replay=False)
    if lives is None:
        raise ValueError(f"{folder.path} has no checkpoint yet; earl-jax resume {folder.path} goes on with the run")
    return env, method, lives.lanes
