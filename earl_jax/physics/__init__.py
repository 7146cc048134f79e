"""MuJoCo behind one door: integration state in, integration state out, on any of three engines.

A lane carries MuJoCo's integration state only, never the whole `mjx.Data`; what a task sees of the world are the sensors of
its MJCF, read as the last substep began (so they lag the state by one substep, as in the original environments), or the
state itself. MuJoCo is imported where it is used, so that kinematic tasks train on a machine without it.
"""

import dataclasses
import importlib.util
from typing import Any

import jax
import numpy as np

from earl_jax.physics import c, mjx
from earl_jax.physics.models import load_model, mjx_data, mujoco_data
from earl_jax.physics.state import Drive, Integration

__all__ = ["Drive", "Integration", "Simulator", "load_model", "mjx_data", "mujoco_data", "resolve"]

ENGINES = ("mjx", "warp", "c")
FASTEST = {"cpu": "c", "gpu": "c"}
"""The engine `auto` takes on a backend for few lanes, by benchmarks/results/physics; elsewhere (TPU) it is mjx."""
HOST_MS = {
    "cheetah_run": 0.027, "dhand_lightbulb": 0.71, "fish_swim": 0.098, "franka_kitchen": 0.49, "minitaur_pen": 0.31,
    "sawyer_door": 0.10, "sawyer_peg": 0.10,
}  # fmt: skip
"""Milliseconds of one core for one lane's control step on `c`, from 1,000 lanes on 16 cores beside an H200."""
DEVICE_MS = {
    "dhand_lightbulb": 103.0, "franka_kitchen": 47.0, "minitaur_pen": 9.1, "sawyer_door": 43.0, "sawyer_peg": 109.0,
}  # fmt: skip
"""Milliseconds of a control step of 1,000 lanes on `mjx` on the same H200; fewer take hardly less."""
EXTRAS = {"mjx": ("mujoco.mjx", ""), "warp": ("warp", "[warp]"), "c": ("mujoco", "")}


def resolve(engine: str) -> str:
    """Return the engine that `engine` stands for here: itself, or for `auto` the fastest measured on this backend.

    Raises:
        ValueError: the engine is unknown or not installed; the message names the choices or the extra that brings it.
    """
    if engine == "auto":
        return FASTEST.get(jax.default_backend(), "mjx")
    if engine not in ENGINES:
        raise ValueError(f"unknown physics engine {engine!r}; choose from auto, {', '.join(ENGINES)}")
    module, extra = EXTRAS[engine]
    if importlib.util.find_spec(module.partition(".")[0]) is None:
        raise ValueError(f"physics engine {engine!r} is not installed; get it with: pip install 'earl-jax{extra}'")
    return engine


def fastest(model: str, lanes: int) -> str:
    """Return the engine that steps `lanes` of `model` soonest here, by what was measured for it and the cores of this process."""
    engine = resolve("auto")
    if jax.default_backend() != "gpu" or model not in DEVICE_MS:
        return engine
    host = lanes * HOST_MS[model] / (c.cores() / jax.local_device_count())
    return "mjx" if host > DEVICE_MS[model] * max(1.0, lanes / 1000) else engine


@dataclasses.dataclass(frozen=True)
class Simulator:
    """One MJCF `model` advanced by `substeps` of `timestep` seconds a control step on `engine` (one of `ENGINES`).

    A `drive` turns the command of a control step into each substep's controls. `varied` names fields of the compiled model
    (`body_mass`, `pair_friction`, ...) of which every lane carries its own values in `Integration.constants`.
    """

    model: str
    timestep: float
    substeps: int
    engine: str
    drive: Drive | None = None
    varied: tuple[str, ...] = ()

    def step(self, state: Integration, command: jax.Array) -> tuple[Integration, jax.Array]:
        """Return the state one control step later under `command` (controls [nu], or what the drive takes), and the
        sensors [nsensordata] of its last substep.

        Pure and unbatched: under vmap `mjx` and `warp` run all lanes in one program, `c` in one threaded call.
        """
        return self.land(state, self.launch(state, command))

    def launch(self, state: Integration, command: jax.Array) -> jax.Array:
        """Return the control step that begins at `state` under `command`, on its way: with `c` beside a GPU the host works
        on it from here on, and what the program does before `land` runs meanwhile."""
        return c.launch(self, state, command) if self.engine == "c" else command

    def land(self, state: Integration, flight: jax.Array) -> tuple[Integration, jax.Array]:
        """Return what `step` returns, of the step that `launch` began at `state`."""
        return (c.land if self.engine == "c" else mjx.step)(self, state, flight)

    def mujoco_model(self) -> Any:
        """Return the compiled `mujoco.MjModel` at this simulator's time step."""
        return load_model(self.model, self.timestep)

    def controls(self, xp: Any, qpos: Any, qvel: Any, command: Any, memory: Any) -> tuple[Any, Any]:
        """Return the controls of the next substep and what the drive remembers: the command and nothing without one."""
        if self.drive is None:
            return command, memory
        return self.drive(xp, qpos, qvel, command, memory)

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
