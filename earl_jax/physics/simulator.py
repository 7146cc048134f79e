"""A compiled model and its control step on any of the three engines."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.errors import InputError
from earl_jax.physics.engines import c, mjx
from earl_jax.physics.models import load_model
from earl_jax.physics.state import Actuator, PendingStep, PhysicsState


@dataclasses.dataclass(frozen=True)
class Simulator:
    """A simulator of the MJCF `model` on `engine`; a control step has `substeps` physics steps of `timestep` seconds.

    A lane carries MuJoCo's integration state only, never the whole `mjx.Data`. A task observes that state and the
    sensors of its MJCF. Sensors are computed at the start of the last substep, so they lag the state by one substep, as
    in the original environments.

    An `actuator` converts the command of a control step into the controls of each substep. `varied` names fields of the
    compiled model (`body_mass`, `pair_friction`, ...) whose values differ between lanes; `PhysicsState.constants` holds
    them.
    """

    model: str
    timestep: float
    substeps: int
    engine: str
    actuator: Actuator | None = None
    varied: tuple[str, ...] = ()

    def step(self, state: PhysicsState, command: jax.Array) -> tuple[PhysicsState, jax.Array]:
        """Return the state one control step later and the sensors [nsensordata] of its last substep.

        `command` is the controls [nu], or the command that the actuator takes. Pure and unbatched: under vmap, `mjx`
        and `warp` simulate all lanes in one program, and `c` simulates them in one call.
        """
        return self.finish_step(state, self.start_step(state, command))

    def start_step(self, state: PhysicsState, command: jax.Array) -> PendingStep:
        """Start a control step from `state` with `command` and return it for `finish_step`.

        With `c` and a GPU, the host simulates the step while the program continues up to `finish_step`.

        Raises:
            ValueError: a field of `state`, or the controls, do not have the shape that the model requires.
        """
        self._require_shapes(state, command)
        return c.start_step(self, state, command) if self.engine == "c" else PendingStep(command)

    def finish_step(self, state: PhysicsState, pending: PendingStep) -> tuple[PhysicsState, jax.Array]:
        """Return the result of the step that `start_step` started from `state`, as `step` does."""
        if self.engine == "c":
            return c.finish_step(self, state, pending)
        return mjx.step(self, state, pending.payload)

    def _require_shapes(self, state: PhysicsState, command: jax.Array) -> None:
        """Raise an InputError that names what does not have the shape of the model. Only an actuator knows its command."""
        model = self.mujoco_model()
        shapes = {
            "qpos": (model.nq,), "qvel": (model.nv,), "act": (model.na,), "qacc_warmstart": (model.nv,),
            "mocap_pos": (model.nmocap, 3), "mocap_quat": (model.nmocap, 4),
        }  # fmt: skip
        given = {name: jnp.shape(getattr(state, name)) for name in shapes}
        if self.actuator is None:
            given["ctrl"], shapes["ctrl"] = jnp.shape(command), (model.nu,)
        for name, shape in given.items():
            if shape != shapes[name]:
                raise InputError(f"{name} has shape {shape}, the model {self.model} takes {shapes[name]}")

    def mujoco_model(self) -> Any:
        """Return the compiled `mujoco.MjModel` with this simulator's time step."""
        return load_model(self.model, self.timestep)

    def variation(self, constants: jax.Array) -> dict[str, jax.Array]:
        """Return a lane's `constants [k]` as the model fields `varied`, in their shapes."""
        nominal = [getattr(self.mujoco_model(), field) for field in self.varied]
        parts = jnp.split(constants, np.cumsum([values.size for values in nominal])[:-1])
        shaped = [part.reshape(values.shape) for part, values in zip(parts, nominal, strict=True)]
        return dict(zip(self.varied, shaped, strict=True))
