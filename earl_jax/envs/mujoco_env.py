"""The base class of tasks with a MuJoCo model: its engine, its substeps, and a control step that uses both."""

import abc
import dataclasses
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import assets
from earl_jax.envs.base import Env, NextState, State
from earl_jax.envs.checks import require_tuple
from earl_jax.envs.features import View
from earl_jax.options.values import Interval, require
from earl_jax.physics import EngineCost, PendingStep, PhysicsState, Simulator, resolve_engine
from earl_jax.physics.models import require_unchanged

SUBSTEPS = Interval("[1, 1000]", whole=True)


@dataclasses.dataclass(frozen=True)
class MujocoEnv(Env):
    """A task with a MuJoCo model: `engine` is `auto`, `mjx`, `c` or `warp`; a control step has `substeps` physics steps.

    The model is `assets/mjcf/<name>.xml`, unless `model` names another. A subclass defines the members that
    `KinematicEnv` lists, with `control`, `observe` and `control_step` instead of `transition`.
    """

    engine: Literal["auto", "mjx", "warp", "c"] = "auto"
    substeps: int = 1
    """Physics steps in a control step."""

    control_step: ClassVar[float]
    """Duration of a control step, seconds."""
    engine_cost: ClassVar[EngineCost | None] = None
    """Measured costs, from which `engine="auto"` chooses an engine; None chooses the backend's default engine."""

    def __post_init__(self):
        super().__post_init__()
        require("substeps", self.substeps, SUBSTEPS)
        if self.engine != "auto":
            resolve_engine(self.engine)
        require_unchanged(self.model)

    @property
    def model(self) -> str:
        """The task's MJCF: its name in assets, or a path."""
        return assets.asset_name(self)

    @property
    def view(self) -> View:
        """The view that draws the simulated model in real time, and its goal if the task defines `_at_goal`."""
        return View(self.model, dt=self.control_step, render_goal=self._at_goal)

    def _at_goal(self, state: State) -> PhysicsState | None:
        """Return the physics state at the goal of `state`, for pictures; None draws no goal."""

    @property
    def simulator(self) -> Simulator:
        """The simulator of this task's model on its engine."""
        return Simulator(
            model=self.model,
            timestep=self.control_step / self.substeps,
            substeps=self.substeps,
            engine=resolve_engine(self.engine),
        )

    @abc.abstractmethod
    def control(self, state: State, action: jax.Array) -> tuple[PhysicsState, jax.Array]:
        """Return the physics state and the command that start a control step with the clipped `action [a]`."""

    @abc.abstractmethod
    def observe(self, state: State, action: jax.Array, data: PhysicsState, sensors: jax.Array) -> NextState:
        """Return the result of a step from the simulated `data` and the last substep's `sensors [nsensordata]`."""

    def start_step(self, state: State, action: jax.Array) -> PendingStep:
        action = self._checked_action(action)
        data, command = require_tuple(f"{self.name}: control", self.control(state, action), tuple, "data", "command")
        physics = self.simulator.start_step(data, command)
        return PendingStep((action, data, physics.payload), physics.ticket)

    def finish_step(self, state: State, pending: PendingStep) -> State:
        action, data, payload = pending.payload
        data, sensors = self.simulator.finish_step(data, PendingStep(payload, pending.ticket))
        return self._next_state(state, action, self.observe(state, action, data, sensors))


def leashed_target(
    target: jax.Array, hand: jax.Array, fastest: jax.Array, speeds: np.ndarray, lengths: np.ndarray
) -> jax.Array:
    """Return the position [3] to which a mocap weld pulls a hand: `target [3]`, or a nearer point if that is too far.

    The position may lead the `hand [3]` by `lengths [2]` metres when the `fastest` joint turns at `speeds [2]` rad/s;
    lengths are interpolated linearly in between.
    """
    # JAX's own interpolation searches in a loop, which takes 25 us on a GPU.
    between = lengths[0] + (lengths[1] - lengths[0]) / (speeds[1] - speeds[0]) * (fastest - speeds[0])
    leash = jnp.where(fastest < speeds[0], lengths[0], jnp.where(fastest > speeds[1], lengths[1], between))
    distance = jnp.linalg.norm(target - hand)
    return jnp.where(distance > leash, hand + (target - hand) * leash / jnp.maximum(distance, leash), target)
