"""One compiled model, advanced by a control step on any of the three engines."""

import dataclasses
from typing import Any

import jax
import numpy as np

from earl_jax.physics.engines import c, mjx
from earl_jax.physics.models import load_model
from earl_jax.physics.state import Actuator, PendingStep, PhysicsState


@dataclasses.dataclass(frozen=True)
class Simulator:
    """One MJCF `model` advanced by `substeps` of `timestep` seconds a control step on `engine` (one of `ENGINES`).

    A lane carries MuJoCo's integration state only, never the whole `mjx.Data`. A task sees the state itself and the sensors
    of its MJCF, which are read when the last substep begins. They lag the state by one substep, as in the original
    environments.

    An `actuator` turns the command of a control step into each substep's controls. `varied` names fields of the compiled
    model (`body_mass`, `pair_friction`, ...) whose values differ by lane and are carried in `PhysicsState.constants`.
    """

    model: str
    timestep: float
    substeps: int
    engine: str
    actuator: Actuator | None = None
    varied: tuple[str, ...] = ()

    def step(self, state: PhysicsState, command: jax.Array) -> tuple[PhysicsState, jax.Array]:
        """Return the state one control step later and the sensors [nsensordata] of its last substep.

        `command` holds controls [nu], or whatever the actuator takes. Pure and unbatched: under vmap `mjx` and `warp` run all
        lanes in one program, and `c` runs them in one threaded call.
        """
        return self.finish_step(state, self.start_step(state, command))

    def start_step(self, state: PhysicsState, command: jax.Array) -> PendingStep:
        """Return the control step that begins at `state` under `command`.

        With `c` beside a GPU the host computes it from here on, while the program goes on to `finish_step`.
        """
        return c.start_step(self, state, command) if self.engine == "c" else PendingStep(command)

    def finish_step(self, state: PhysicsState, pending: PendingStep) -> tuple[PhysicsState, jax.Array]:
        """Return what `step` returns, for the step that `start_step` began at `state`."""
        if self.engine == "c":
            return c.finish_step(self, state, pending)
        return mjx.step(self, state, pending.payload)

    def mujoco_model(self) -> Any:
        """Return the compiled `mujoco.MjModel` at this simulator's time step."""
        return load_model(self.model, self.timestep)

    def controls(self, xp: Any, qpos: Any, qvel: Any, command: Any, memory: Any) -> tuple[Any, Any]:
        """Return the controls of the next substep and the actuator's new memory; without an actuator, the command itself."""
        if self.actuator is None:
            return command, memory
        return self.actuator(xp, qpos, qvel, command, memory)

    @property
    def variation_size(self) -> int:
        """Length k of a lane's own constants."""
        return sum(getattr(self.mujoco_model(), field).size for field in self.varied)

    def variation(self, constants: Any) -> dict[str, Any]:
        """Return a lane's `constants [k]` as fields of the model, in their shapes."""
        shapes = {field: getattr(self.mujoco_model(), field).shape for field in self.varied}
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes.values()]).tolist()
        starts = [0, *ends[:-1]]
        return {
            field: constants[start:end].reshape(shape)
            for (field, shape), start, end in zip(shapes.items(), starts, ends, strict=True)
        }
