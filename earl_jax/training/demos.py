"""The demonstrations of a task in the forms that a method uses: rows of the replay to sample, and steps to clone."""

from typing import NamedTuple

import numpy as np

from earl_jax.algos.goals import trajectories
from earl_jax.algos.learner.cloning import DemoSteps
from earl_jax.algos.method import BACKWARD, FORWARD, Method, PhaseDemos
from earl_jax.envs import Env, without_budget
from earl_jax.errors import InputError
from earl_jax.training.state import Problem


class DemoRows(NamedTuple):
    """Demonstrations in the layout of replay rows.

    `states [R, s]`. The other fields describe T demonstrated transitions, once for each controller that samples them:
    `rows [T]`, `actions [T, a]`, `goals [T]`, `controllers [T]`, and the number of `copies [T]` in the replay's lists.
    """

    states: np.ndarray
    rows: np.ndarray
    actions: np.ndarray
    goals: np.ndarray
    controllers: np.ndarray
    copies: np.ndarray

    def sampleable(self, controller: int) -> np.ndarray:
        """Return the rows that `controller` samples from, each repeated by its number of copies."""
        own = self.controllers == controller
        return np.repeat(self.rows[own], self.copies[own])

    def steps(self, goals: np.ndarray) -> DemoSteps | None:
        """Return the steps that every controller clones, under goals of the table `goals [M, g]`; None if there are none."""
        if not len(self.rows):
            return None
        obs = np.concatenate([self.states[self.rows], goals[self.goals]], axis=-1)
        return DemoSteps(obs, self.actions, self.controllers)


def demo_rows(problem: Problem, method: Method) -> DemoRows:
    """Return the demonstrations in the initial replay of `method`: no rows if the task lacks the method's directions.

    Raises:
        ValueError: the method needs demonstrations, and the task has none or its states cannot be goals.
    """
    env = problem.env
    if method.needs_demos and not env.demonstrations.recorded:
        remedy = f"; set demo_file=FILE, recorded by: earl-jax demos {env.name} --out FILE"
        remedy = remedy if env.demonstrations.script else ""
        raise InputError(f"{method.name} needs demonstrations, and {env.name} has none{remedy}")
    if method.needs_demos and env.state_size != env.goal_size:
        helped = "" if without_budget(env) is env else " with a budget"
        raise InputError(
            f"{method.name} needs demonstrated states that can be goals, but a state of {env.name}{helped} has "
            f"{env.state_size} numbers and a goal has {env.goal_size}"
        )
    parts, all_states, first, uses = [], [], 0, used_demos(env, method)
    for direction in env.demonstrations.directions:
        used = [(controller, demos) for controller, demos in uses if demos.direction == direction]
        if not used:
            continue
        recorded = env.demonstrations.load(direction)
        states, last = trajectories(recorded)
        rows = np.flatnonzero(np.arange(len(states)) < last)
        goals, later = _goal_indices(problem, recorded.goals), last[rows] - rows
        for controller, demos in used:
            copies = np.maximum(1, np.rint(later * demos.copies_per_step).astype(int))
            copies = copies * (len(env.goal_states) if demos.every_goal else 1)
            parts.append((first + rows, recorded.actions, goals, np.full(len(rows), controller), copies))
        all_states.append(states)
        first += len(states)
    if not parts:
        return DemoRows(*np.zeros((len(DemoRows._fields), 0), int))
    fields = [np.concatenate(field) for field in zip(*parts, strict=True)]
    return DemoRows(np.concatenate(all_states), *fields)


def used_demos(env: Env, method: Method) -> list[tuple[int, PhaseDemos]]:
    """Return the controllers of `method` with the demonstrations of `env` for their phases or, with `all_demos`, all."""
    uses = list(dict.fromkeys((phase.controller, demos) for phase in method.phases for demos in phase.demos))
    if method.learner.all_demos:
        own = {(controller, demos.direction) for controller, demos in uses}
        controllers = dict.fromkeys(controller for controller, _ in uses)
        every = [(controller, demos) for controller in controllers for demos in (FORWARD, BACKWARD)]
        uses += [use for use in every if (use[0], use[1].direction) not in own]
    directions = env.demonstrations.directions
    return [(controller, demos) for controller, demos in uses if demos.direction in directions]


def _goal_indices(problem: Problem, goals: np.ndarray) -> np.ndarray:
    """Return indices [T] into the goal table for demonstrated goals [T, g], which are task goals or initial states."""
    known = problem.goals.table[: problem.goals.tasks + problem.goals.initials]
    distance = np.abs(goals[:, None] - known[None]).max(axis=-1)
    if distance.min(axis=1).max() > 1e-6:
        raise InputError(
            f"a demonstration of {problem.env.name} has a goal that is neither a task goal nor an initial state"
        )
    return distance.argmin(axis=1)
