"""The work of a sweep that needs jax: to plan grids, and to train groups of runs that share a program."""

import contextlib
import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

from earl_jax.envs import chosen_engine, for_lanes
from earl_jax.errors import InputError
from earl_jax.options import imports
from earl_jax.options.jax_settings import package_types
from earl_jax.options.values import TimeLimit, counted
from earl_jax.runs.checkpoint import newest
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import has_results
from earl_jax.runs.files import check_folder, inside
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.logging import check_logs
from earl_jax.runs.policies import policies_step
from earl_jax.sweeps import grid
from earl_jax.sweeps.processes import cause_of
from earl_jax.training import memory
from earl_jax.training.api import make_run, require_checkpoint
from earl_jax.training.demos import demo_rows
from earl_jax.training.plan import program_structure
from earl_jax.training.runner import Program, Run
from earl_jax.training.state import Problem

Emit = Callable[[str, str, str], None]
"""Receives the name of a run, its state (started, resumed, done, stopped or failed), and the step or the cause as text."""


@dataclasses.dataclass(frozen=True)
class PlannedRun:
    """A run of a sweep: its `name` in the sweep, its objects, and the step from which it would continue."""

    name: str
    run: Run
    step: int

    @property
    def finished(self) -> bool:
        """Whether the run has reached its last step."""
        return self.step == self.run.config.steps

    def group_key(self) -> Hashable:
        """Return the properties that all runs of one program have in common."""
        env, shared = self.run.env, self.run.protocol.without_rules
        if not env.has_absorbing_state:
            env = dataclasses.replace(env, train_horizon=1)  # lanes carry the horizon as data
        return env, self.run.config.schedule, shared, self.step, program_structure(self.run.method)


def program_groups(planned: Sequence[PlannedRun], max_lanes: int | None = None) -> list[list[PlannedRun]]:
    """Return the unfinished runs of `planned` in groups of one program each, with at most `max_lanes` lanes if given.

    Raises:
        ValueError: a single run has more than `max_lanes` lanes.
    """
    by_key: dict[Hashable, list[list[PlannedRun]]] = {}
    for entry in planned:
        if entry.finished:
            continue
        if max_lanes is not None and entry.run.lanes > max_lanes:
            raise InputError(
                f"{entry.name} has {counted(entry.run.lanes, 'seed')}, more than {counted(max_lanes, 'lane')}; a run is never "
                "split, so raise max_lanes or give it fewer seeds"
            )
        groups = by_key.setdefault(entry.group_key(), [[]])
        if max_lanes is not None and sum(other.run.lanes for other in groups[-1]) + entry.run.lanes > max_lanes:
            groups.append([])
        groups[-1].append(entry)
    return [group for groups in by_key.values() for group in groups]


@package_types()
def plan(path: Path, out: Path, max_lanes: int | None = None, logs: Sequence[str] = ()) -> dict[str, Any]:
    """Return the plan of a grid as JSON values (`launcher.plan_sweep` describes them); nothing is written.

    Raises:
        ValueError: a log is unknown, or a run is invalid, its folder holds another run, or it began without one of
            `logs`; the message names it.
    """
    check_logs(logs)
    check_folder(out)
    out = out.resolve()
    planned = [planned_run(spec, out, logs) for spec in grid.read(path)]
    groups = list(map(_described, program_groups(planned, max_lanes)))
    finished = [entry.name for entry in planned if entry.finished]
    return {"out": str(out), "imports": imports.records(), "finished": finished, "groups": groups}


def _described(group: list[PlannedRun]) -> dict[str, Any]:
    """Return a program group as JSON values; its runs have one task, schedule and structure of method, so one size of replay."""
    first, lanes = group[0].run, sum(entry.run.lanes for entry in group)
    replay = memory.replay_bytes(Problem(first.env, first.protocol), first.method, first.config.steps)
    return {
        "runs": {entry.name: dataclasses.asdict(entry.run.config) for entry in group},
        "lanes": lanes,
        "step": group[0].step,
        "steps": first.config.steps,
        "replay_bytes": lanes * replay,
    }


def planned_run(spec: grid.RunSpec, out: Path, logs: Sequence[str] = ()) -> PlannedRun:
    """Return a run of a grid, after all checks that are possible before training. Errors as `plan`."""
    run, path = resolved_run(spec), out / spec.name
    if not has_results(path):
        return PlannedRun(name=spec.name, run=run, step=0)
    folder = open_folder(path, run.config)
    step, steps = newest(folder.checkpoints), folder.config.steps
    if step == 0 and policies_step(folder.policies) == steps == folder.table().step:
        step = steps  # of a finished run, whose checkpoints were removed
    if step < run.config.steps and (missing := [log for log in logs if log not in folder.logs]):
        raise InputError(f"{path} began without the log {missing[0]}; leave out --log, or choose another --out")
    return PlannedRun(name=spec.name, run=run, step=step)


def resolved_run(spec: grid.RunSpec) -> Run:
    """Return the objects of a run of a grid, after the checks that need no folder. Errors as `plan`."""
    try:
        run = make_run(spec.env, spec.algo, spec.options, spec.seeds, spec.schedule, engine=None)
        demo_rows(Problem(run.env, run.protocol), run.method)
    except InputError as error:
        raise InputError(f"{spec.name}: {error}") from error
    return run


def open_folder(path: Path, config: RunConfig) -> RunFolder:
    """Return the folder at `path` with the run `config`, or with its first steps.

    Raises:
        ValueError: the folder is damaged, rows of its metrics are missing, it holds another or a longer run (the message
            gives the differences), or an unfinished one whose checkpoints were removed.
    """
    folder = RunFolder.open(path)
    existing, wanted = folder.config.values, config.values
    shorter = folder.config.steps < config.steps and existing | {"steps": config.steps} == wanted
    if not shorter:
        require_same(f"{path} holds a run", existing, wanted)
    step = folder.require_resumable().step
    if step < config.steps:
        require_checkpoint(folder, step)
    return folder


def require_same(owner: str, there: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Raise an InputError with the values that differ unless `owner`, which has those of `there`, has the ones `wanted`."""
    names = [name for name in {**there, **wanted} if there.get(name) != wanted.get(name)]
    if names:
        differences = "; ".join(f"{name} {there.get(name)} there, {wanted.get(name)} here" for name in names)
        raise InputError(
            f"{owner} that differs ({differences}); choose another --out, or use the values that are there"
        )


@package_types()
def work(
    out: Path,
    configs: dict[str, RunConfig],
    emit: Emit,
    *,
    progress: bool = True,
    devices: int | None = None,
    logs: Sequence[str] = (),
    limit: TimeLimit | None = None,
) -> None:
    """Train the runs `configs`, by name in the sweep at `out`; `emit` receives every event.

    The runs are grouped again by the steps of their newest checkpoints. A run that fails does not stop the others. Runs end
    early, as `stopped`, when the `limit` passes, also those of groups that have not started by then.
    """
    planned: list[PlannedRun] = []
    with contextlib.ExitStack() as stack:
        for name, config in configs.items():
            try:
                run, path = Run.resolve(config), inside(out, name)
                if not has_results(path):
                    RunFolder.create(path, config, chosen_engine(for_lanes(run.env, run.lanes)), logs)
                run.folder = open_folder(path, config)
                check_logs(run.folder.logs)
                stack.enter_context(run.folder.claimed())
                planned.append(PlannedRun(name=name, run=run, step=newest(run.folder.checkpoints)))
            except Exception as error:
                emit(name, "failed", cause_of(error))
        for entry in planned:
            if entry.finished:
                emit(entry.name, "done", "")
        for group in program_groups(planned):
            if not (limit and limit.passed):
                _train_group(group, emit, progress, devices, limit)
                continue
            for entry in group:
                emit(entry.name, "stopped", f"at step {entry.step}")


def _train_group(
    group: list[PlannedRun], emit: Emit, progress: bool, devices: int | None, limit: TimeLimit | None
) -> None:
    """Train all runs of `group` in one program."""
    for entry in group:
        emit(entry.name, *(("resumed", f"from step {entry.step}") if entry.step else ("started", "")))
    try:
        runs = [entry.run for entry in group]
        step = int(Program(runs, devices).run(progress, limit).step)
        state, detail = ("done", "") if step == runs[0].config.steps else ("stopped", f"at step {step}")
    except Exception as error:
        state, detail = "failed", cause_of(error)
    for entry in group:
        emit(entry.name, state, detail)
