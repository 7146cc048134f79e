"""What every task with a physics engine shares: which engine steps it, how finely, and how a control step passes through it."""

import abc
import dataclasses
import functools
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.base import Env, State
from earl_jax.physics import Drive, Integration, Simulator, fastest, resolve


@dataclasses.dataclass(frozen=True)
class PhysicalEnv(Env):
    """A task of `assets/mjcf/<name>.xml`: `physics` names its engine, `substeps` divide its control step."""

    physics: str = "auto"
    substeps: int = 1

    control_step: ClassVar[float]
    """Seconds of a control step."""

    def __post_init__(self):
        super().__post_init__()
        if self.substeps < 1:
            raise ValueError(f"substeps must be at least 1, not {self.substeps}")
        if self.physics != "auto":
            resolve(self.physics)

    @property
    def engine(self) -> str:
        return resolve(self.physics)

    def for_lanes(self, lanes: int) -> "PhysicalEnv":
        return dataclasses.replace(self, physics=fastest(self.model, lanes)) if self.physics == "auto" else self

    @property
    def model(self) -> str:
        """The name of this task's MJCF in assets."""
        return self.name

    @property
    def drive(self) -> Drive | None:
        """What turns the command of a control step into the controls of each substep; None for the command itself."""
        return None

    @property
    def varied(self) -> tuple[str, ...]:
        """Fields of the compiled model of which every lane has its own values."""
        return ()

    @functools.cached_property
    def simulator(self) -> Simulator:
        """The physics of this task on its engine."""
        step = self.control_step / self.substeps
        return Simulator(self.model, step, self.substeps, self.engine, self.drive, self.varied)

    @abc.abstractmethod
    def _command(self, state: State, action: jax.Array) -> tuple[Integration, jax.Array]:
        """Return the integration state to simulate from, and the command for it, of a control step with `action [a]`."""

    @abc.abstractmethod
    def _arrive(
        self, state: State, action: jax.Array, data: Integration, sensors: jax.Array
    ) -> tuple[Integration, jax.Array, dict[str, jax.Array]]:
        """Return what `_land` does, given the simulated `data` and the `sensors [nsensordata]` of its last substep."""

    def _launch(self, state: State, action: jax.Array) -> Any:
        data, command = self._command(state, action)
        return action, data, self.simulator.launch(data, command)

    def _land(self, state: State, flight: Any) -> tuple[Integration, jax.Array, dict[str, jax.Array]]:
        action, data, moving = flight
        return self._arrive(state, action, *self.simulator.land(data, moving))


def leashed(
    target: jax.Array, hand: jax.Array, fastest: jax.Array, speeds: np.ndarray, lengths: np.ndarray
) -> jax.Array:
    """Return the place [3] that a mocap weld pulls a hand to: `target [3]`, or nearer to `hand [3]` where that is too far.

    It may lead by `lengths [2]` metres while the `fastest` joint [rad/s] turns at `speeds [2]`; linear between.
    """
    distance, leash = jnp.linalg.norm(target - hand), jnp.interp(fastest, speeds, lengths)
    return jnp.where(distance > leash, hand + (target - hand) * leash / jnp.maximum(distance, leash), target)
