"""The planner of sweeps: it groups runs that can share one program. Each run keeps its own folder."""

import dataclasses
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

from earl_jax.algos import method_for
from earl_jax.errors import InputError
from earl_jax.runs.checkpoint import newest
from earl_jax.runs.config import RunConfig
from earl_jax.runs.contents import has_results
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.policies import policies_step
from earl_jax.sweeps import grid
from earl_jax.training import memory, split_options
from earl_jax.training.init import demo_rows
from earl_jax.training.plan import program_structure
from earl_jax.training.runner import Run
from earl_jax.training.state import Problem


@dataclasses.dataclass(frozen=True)
class PlannedRun:
    """A run of a sweep: its `name` in the sweep, its objects, and the step from which it would continue."""

    name: str
    run: Run
    step: int

    @property
    def lanes(self) -> int:
        """Number of lanes, one for each seed."""
        return len(self.run.config.seeds)

    @property
    def finished(self) -> bool:
        """Whether the run has reached its last step."""
        return self.step == self.run.config.steps

    def group_key(self) -> Hashable:
        """Return the properties that all runs of one program have in common."""
        config, env = self.run.config, self.run.env
        lengths = (config.steps, config.eval_every, config.eval_episodes, config.checkpoint_every, self.step)
        lengths += (self.run.protocol.alive_steps,)
        task = env if env.ends else dataclasses.replace(env, train_horizon=1)  # lanes carry the horizon as data
        return task, lengths, program_structure(self.run.method)

    def replay_bytes(self) -> int:
        """Return the bytes of the replay buffers of all lanes."""
        problem = Problem(self.run.env, self.run.protocol)
        return self.lanes * memory.replay_bytes(problem, self.run.method, self.run.config.steps)


def program_groups(planned: Sequence[PlannedRun], max_lanes: int | None = None) -> list[list[PlannedRun]]:
    """Return the unfinished runs of `planned` in groups of one program each, with at most `max_lanes` lanes if given.

    Raises:
        ValueError: a single run has more than `max_lanes` lanes.
    """
    by_key: dict[Hashable, list[list[PlannedRun]]] = {}
    for entry in planned:
        if entry.finished:
            continue
        if max_lanes is not None and entry.lanes > max_lanes:
            raise InputError(
                f"{entry.name} has {entry.lanes} seeds, more than {max_lanes} lanes; a run is never split, "
                "so raise max_lanes or give it fewer seeds"
            )
        groups = by_key.setdefault(entry.group_key(), [[]])
        if max_lanes is not None and sum(other.lanes for other in groups[-1]) + entry.lanes > max_lanes:
            groups.append([])
        groups[-1].append(entry)
    return [group for groups in by_key.values() for group in groups]


def plan(path: Path, out: Path, max_lanes: int | None = None) -> dict[str, Any]:
    """Return the plan of a grid as JSON values (`launcher.plan_sweep` describes them); nothing is written.

    Raises:
        ValueError: a run is invalid, or its folder holds another run; the message names it.
    """
    planned = [planned_run(spec, out) for spec in grid.read(path)]
    runs = {entry.name: {"step": entry.step, "config": dataclasses.asdict(entry.run.config)} for entry in planned}
    groups = [
        {
            "runs": [entry.name for entry in group],
            "lanes": sum(entry.lanes for entry in group),
            "step": group[0].step,
            "steps": group[0].run.config.steps,
            "replay_bytes": sum(entry.replay_bytes() for entry in group),
        }
        for group in program_groups(planned, max_lanes)
    ]
    return {"out": str(out), "runs": runs, "groups": groups}


def planned_run(spec: grid.RunSpec, out: Path) -> PlannedRun:
    """Return a run of a grid, after all checks that are possible before training."""
    path = out / spec.name
    try:
        env, setting, options = split_options(spec.env, spec.options)
        method = method_for(env, spec.algo, **options)
        config = RunConfig.from_objects(
            env,
            method,
            setting,
            seeds=spec.seeds,
            steps=spec.steps,
            eval_every=spec.eval_every,
            eval_episodes=spec.eval_episodes,
            checkpoint_every=spec.checkpoint_every,
        )
        run = Run.resolve(config, env, method)
        demo_rows(Problem(env, run.protocol), run.method)
        step = _reached(open_folder(path, config)) if has_results(path) else 0
    except InputError as error:
        raise InputError(f"{spec.name}: {error}") from error
    return PlannedRun(name=spec.name, run=run, step=step)


def _reached(folder: RunFolder) -> int:
    """Return the step of the newest checkpoint, or the last step of a finished run whose checkpoints were removed."""
    step, steps = newest(folder.checkpoints), folder.config.steps
    if step == 0 and policies_step(folder.policies) == steps:
        rows = folder.rows()
        return steps if rows and rows[-1]["step"] == steps else 0
    return step


def open_folder(path: Path, config: RunConfig) -> RunFolder:
    """Return the folder at `path` with the run `config`.

    Raises:
        ValueError: the folder is damaged, rows of its metrics are missing, or it holds another run; the message gives
            the differences.
    """
    folder = RunFolder.open(path)
    existing, wanted = folder.config.values, config.values
    differing = [name for name in wanted if existing[name] != wanted[name]]
    if differing:
        differences = "; ".join(f"{name} {existing[name]} there, {wanted[name]} in the grid" for name in differing)
        raise InputError(
            f"{path} holds a run that differs ({differences}); choose another --out, or change the grid to match"
        )
    folder.require_rows()
    return dataclasses.replace(folder, config=config)
