"""One jitted program and the runs that share it: chunks of the loop, then evaluations, logs and checkpoints."""

import contextlib
import dataclasses
import functools
import itertools
import operator
import time
from collections.abc import Callable, Iterator, Sequence

import jax
import numpy as np
from jax.sharding import Mesh

from earl_jax.algos import Method
from earl_jax.envs import Env, chosen_engine, for_lanes
from earl_jax.metrics.scores import as_decimals
from earl_jax.options.values import TimeLimit, counted
from earl_jax.protocol import Protocol, Rules
from earl_jax.runs.checkpoint import restore_together, save
from earl_jax.runs.config import RunConfig
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.hosts import first_host, gathered, require_same_on_hosts
from earl_jax.runs.logging import Log, OptionalLog, open_logs
from earl_jax.runs.policies import save_policies
from earl_jax.runs.progress import Progress
from earl_jax.runs.table import Table
from earl_jax.training import memory
from earl_jax.training.devices import LANES, TRAIN_STATE, mapped, placed
from earl_jax.training.evaluation import evaluate_lanes
from earl_jax.training.init import check_lanes, init_train_state, replay_steps
from earl_jax.training.plan import join_lanes, make_plan, per_lane
from earl_jax.training.policy import policies_of
from earl_jax.training.program_cache import use_program_cache
from earl_jax.training.result import Result
from earl_jax.training.scan import run_steps
from earl_jax.training.state import LaneState, Problem, TrainState, seed_keys
from earl_jax.training.stopping import Stopped, StopRequest


@dataclasses.dataclass
class Run:
    """One of the runs of a program, with the objects of its config.

    `method` has leaves [n]. `folder`, if not None, and `listeners` receive the metrics, which `table` contains.
    """

    config: RunConfig
    env: Env
    method: Method
    protocol: Protocol
    folder: RunFolder | None = None
    listeners: Sequence[Log] = ()
    table: Table = dataclasses.field(default_factory=Table)

    @classmethod
    def resolve(cls, config: RunConfig, env: Env | None = None, method: Method | None = None) -> "Run":
        """Return the run of `config`; an `env` or `method` that is not given is built from it."""
        env, method = env or config.build_env(), method or config.build_method()
        return cls(config, env, per_lane(method, len(config.seeds)), config.protocol(env))

    @property
    def lanes(self) -> int:
        """Number of lanes, one for each seed."""
        return len(self.config.seeds)

    @contextlib.contextmanager
    def logged(self, step: int) -> Iterator[None]:
        """Open the logs of this run at `step`; metrics of later steps are dropped and logged again."""
        self.table = self.folder.table_until(step) if self.folder and first_host() else Table()
        unfinished = step < self.config.steps and first_host()
        folder = self.folder and dataclasses.replace(self.folder, config=self.config)  # resumed, it can be longer
        self._logs = open_logs(folder, self.listeners, step) if unfinished else []
        try:
            yield
        finally:
            for log in self._logs:
                OptionalLog(type(log).__name__, log).close()

    def add(self, step: int, metrics: dict[str, np.ndarray]) -> None:
        """Write `metrics [n]` at `step` to the folder, to every log and to the table."""
        if self.folder and first_host():
            self.folder.append(step, metrics)
        for log in self._logs:
            log.log(step, {name: values.copy() for name, values in metrics.items()})
        self.table = self.table.extended(step, metrics)

    def result(self, state: TrainState, engine: str) -> Result:
        """Return the result of this run, which must be the only one of its program, from the lanes in `state`."""
        return Result(
            config=self.config,
            engine=engine,
            step=int(gathered(state.step)),
            steps=self.table.steps,
            metrics=self.table.metrics,
            folder=self.folder,
            train_state=state,
            objects=(self.env, self.method),
        )


@functools.partial(jax.jit, static_argnames=("problem", "steps", "mesh"))
def _init(problem: Problem, method: Method, keys: jax.Array, rules: Rules, steps: int, mesh: Mesh | None) -> TrainState:
    init = mapped(lambda m, k, r: init_train_state(problem, m, k, steps, r), mesh, (LANES, LANES, LANES), TRAIN_STATE)
    return init(method, keys, rules)


@functools.partial(jax.jit, static_argnames=("problem", "steps", "warmup", "mesh"), donate_argnames="state")
def _advance(
    problem: Problem, method: Method, state: TrainState, steps: int, warmup: bool, mesh: Mesh | None
) -> TrainState:
    run = mapped(lambda m, s: run_steps(problem, m, s, steps, warmup), mesh, (LANES, TRAIN_STATE), TRAIN_STATE)
    return run(method, state)


@functools.partial(jax.jit, static_argnames=("problem", "mesh"), donate_argnames="state")
def _evaluate(
    problem: Problem, method: Method, state: TrainState, mesh: Mesh | None
) -> tuple[TrainState, dict[str, jax.Array]]:
    evaluate = functools.partial(evaluate_lanes, problem)
    return mapped(evaluate, mesh, (LANES, TRAIN_STATE), (TRAIN_STATE, LANES))(method, state)


class Program:
    """One jitted program with its `plan`, for the lanes of all `runs` in their order, which is the same on all hosts.

    The runs must have the same env, schedule, `program_structure` of their methods and step of their newest checkpoint.
    Their rules (H_T, settings) can differ, because lanes carry the rules as arrays; the plan's protocol has no rules.

    Raises:
        ValueError: `make_plan` raises it.
    """

    def __init__(self, runs: Sequence[Run], devices: int | None):
        first, lanes, method = runs[0], sum(run.lanes for run in runs), join_lanes([run.method for run in runs])
        problem = Problem(for_lanes(first.env, lanes), first.protocol.without_rules)
        self._runs, self.plan = runs, make_plan(problem, method, lanes, first.config.steps, devices)
        require_same_on_hosts([run.config.values for run in runs], self.plan.engine, devices)
        self._method = placed(method, self.plan.mesh)

    def trace(self) -> None:
        """Trace the functions of the runs to raise their errors before training; `run` does not trace them again."""
        plan, method = self.plan, self._method
        state = jax.eval_shape(self._initial_state())
        for step in (0, plan.steps - plan.chunk_steps):  # random actions, if there are any, then learning
            warmup = step < plan.random_steps
            state = _advance.eval_shape(plan.problem, method, state, plan.chunk_steps, warmup, plan.mesh)
        _evaluate.eval_shape(plan.problem, method, state, plan.mesh)

    def run(self, progress: bool, limit: TimeLimit | None) -> TrainState:
        """Return the final state of all lanes of the runs, resumed from their newest checkpoints.

        Each run's metrics are added to its `table` and to its folder, which also receives checkpoints of the run's
        lanes. If a `limit` ends training early, the state is that after the chunk in which the time ran out, with a
        checkpoint.

        Raises:
            Stopped: SIGINT, SIGTERM or SIGHUP arrived; the runs with a folder have a checkpoint of the last complete chunk.
        """
        use_program_cache()
        with StopRequest(limit) as stop, contextlib.ExitStack() as stack:
            init = self._initial_state()
            state = self._restored(init)
            bar = stack.enter_context(self._progress(progress))
            self._announce(bar)
            if state is None:
                with bar.working("first state"):
                    state = jax.block_until_ready(init())
            step = int(gathered(state.step))
            bar.start_at(step)
            for run in self._runs:
                stack.enter_context(run.logged(step))
            return self._train_to_end(state, step, bar, stop)

    def _initial_state(self) -> Callable[[], TrainState]:
        """Return the function that makes the state of all lanes before the first step."""
        plan, runs = self.plan, self._runs
        keys = placed(seed_keys([seed for run in runs for seed in run.config.seeds]), plan.mesh)
        lanes = [run.lanes for run in runs]
        rules = jax.tree.map(lambda *values: np.repeat(values, lanes), *[run.protocol.rules for run in runs])
        steps = replay_steps(self._method, plan.steps)
        return functools.partial(_init, plan.problem, self._method, keys, placed(rules, plan.mesh), steps, plan.mesh)

    def _restored(self, init: Callable[[], TrainState]) -> TrainState | None:
        """Return the state of the newest checkpoints of the runs, or None if there are none."""
        folders = [run.folder.checkpoints for run in self._runs if run.folder]
        lanes = [run.lanes for run in self._runs]
        saved = restore_together(folders, lanes, jax.eval_shape(init)) if folders else None
        return None if saved is None else placed(saved, self.plan.mesh, TRAIN_STATE)

    def _progress(self, show: bool) -> Progress:
        plan, config = self.plan, self._runs[0].config
        return Progress(
            label=f"{config.algo} x {plan.lanes} on {config.env}",
            steps=plan.steps,
            metric=config.deployed_metric,
            show=show and first_host(),
            compile_time="up to some minutes with mjx" if plan.engine == "mjx" else "about 10 s",
        )

    def _announce(self, bar: Progress) -> None:
        """Tell the memory that the program needs, and its physics engine; warn if checkpoints need more disk than is free."""
        plan, run = self.plan, self._runs[0]
        bar.message(str(plan.memory))
        if run.folder and first_host():
            memory.warn_of_disk(plan.memory, run.folder.path)
        if plan.engine != "kinematic":
            auto = f", which auto takes for {counted(plan.lanes, 'lane')} on this {jax.default_backend()} machine"
            bar.message(f"physics engine: {plan.engine}{auto if chosen_engine(run.env) == 'auto' else ''}")

    def _train_to_end(self, state: TrainState, step: int, bar: Progress, stop: StopRequest) -> TrainState:
        """Return the final state, or the one at a time limit, trained from `step`. Errors as `run`.

        Even with a time limit at least one chunk runs, so repeated commands finish eventually.
        """
        plan, start = self.plan, step
        check_lanes(plan.problem, self._method, state)
        if step == plan.steps:
            bar.message(f"all {step:,} steps were trained before")
            self._record_engine_and_steps()
        stopping = stop.requested
        while step < plan.steps and not stopping:
            state = self._train_chunk(state, step, bar)
            step += plan.chunk_steps
            stop.check()
            if step == start + plan.chunk_steps:
                self._record_engine_and_steps()
            is_evaluated = step % plan.problem.protocol.eval_every == 0
            if is_evaluated:
                state = self._evaluated(state, step, bar)
                stop.check()
            stopping = stop.requested and step < plan.steps
            for run, span in _with_lanes(self._runs):
                if run.folder and (stopping or (is_evaluated and run.config.checkpoint_due(step))):
                    save(run.folder.checkpoints, state, span)
        if stopping and stop.number is not None:
            folder = self._runs[0].folder if len(self._runs) == 1 else None
            raise Stopped(stop.number, step, folder and folder.path, state)
        return state

    def _record_engine_and_steps(self) -> None:
        """Write length and engine of the runs to their configs, once the first steps of all runs have succeeded."""
        for run in self._runs:
            if run.folder and first_host():
                run.folder.record(engine=self.plan.engine, steps=run.config.steps)

    def _train_chunk(self, state: TrainState, step: int, bar: Progress) -> TrainState:
        """Return the state after the chunk of steps that begins at `step`."""
        plan, start_time = self.plan, time.perf_counter()
        warmup = step < plan.random_steps
        with bar.working("random actions" if warmup else "training"):
            state = _advance(plan.problem, self._method, state, plan.chunk_steps, warmup, plan.mesh)
            state.step.block_until_ready()
        bar.advance(plan.chunk_steps, time.perf_counter() - start_time)
        return state

    def _evaluated(self, state: TrainState, step: int, bar: Progress) -> TrainState:
        """Return the state after the evaluation at `step`, from which each run keeps its policies and its metrics."""
        with bar.working("evaluation"), jax.debug_nans(False):  # shares of no phases are nan
            state, metrics = _evaluate(self.plan.problem, self._method, state, self.plan.mesh)
            metrics = {name: as_decimals(values) for name, values in gathered(metrics).items()}
        check_lanes(self.plan.problem, self._method, state)
        save_policies_of(self._runs, self._method, state.lanes, step)
        for run, span in _with_lanes(self._runs):
            run.add(step, {name: values[span] for name, values in metrics.items()})
        bar.report(step, metrics)
        return state


def save_policies_of(runs: Sequence[Run], method: Method, lanes: LaneState, step: int) -> None:
    """Write the task actors and the maps of visits of the `lanes` of each run that has a folder."""
    if not any(run.folder for run in runs):
        return
    policies = policies_of(runs[0].env, method, lanes)
    actors, visits = gathered((policies.actor, lanes.visits))
    for run, span in _with_lanes(runs):
        if run.folder and first_host():
            save_policies(
                run.folder.policies,
                jax.tree.map(operator.itemgetter(span), actors),
                step=step,
                seeds=run.config.seeds,
                obs_size=policies.obs_size,
                action_size=policies.action_size,
                visits=None if visits is None else visits[span],
            )


def _with_lanes(runs: Sequence[Run]) -> Iterator[tuple[Run, slice]]:
    """Return each run with the slice of its lanes."""
    ends = itertools.accumulate(run.lanes for run in runs)
    return zip(runs, itertools.starmap(slice, itertools.pairwise([0, *ends])), strict=True)
