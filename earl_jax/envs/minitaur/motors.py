"""The Minitaur's eight motors: a position command becomes a voltage, a current and a torque, before every substep.

Source: the "accurate" motor model of PyBullet's Minitaur, which the released EARL code switches on. All angles are in the
motors' own sense: the joints of the left legs turn against it (`DIRECTION`).
"""

import dataclasses
from typing import Any

import numpy as np

MOTORS = 8
DIRECTION = np.array([-1, -1, -1, -1, 1, 1, 1, 1], np.float32)
"""Sign of each motor against its joint; order: front left, back left, front right, back right, of each the left one first."""
POSITIONS, SPEEDS = slice(7, 23, 2), slice(6, 22, 2)
"""Where the motors stand in qpos and qvel: each is followed by the knee that it carries."""
RESISTANCE = 0.186
TORQUE_CONSTANT = 0.0954
"""N m per ampere, and volts per rad/s of back-EMF."""
MOST_VOLTS = 50.0
MOST_OBSERVED = 5.7
CURRENTS = np.array([0, 10, 20, 30, 40, 50, 60], np.float32)
TORQUES = np.array([0, 1, 1.9, 2.45, 3.0, 3.25, 3.5], np.float32)
"""Saturation: torque [N m] by current [A], constant beyond."""
FASTEST = 150.0
"""rad/s: a command may lead its motor by what that is in one substep."""
HOT = 2.45
"""N m above which a motor heats."""
PATIENCE = 1.0
"""Seconds on end that a motor may be hot before it shuts down until the next reset."""


def legs_to_motors(xp: Any, action: Any) -> Any:
    """Return the motors' angles [..., 8] for an `action [..., 8]` in leg space: four swings, then four extensions, in [-1, 1].

    Source: the released leg model; an extension of 1 folds a leg, of -1 stretches it.
    """
    swing, extension = xp.repeat(action[..., :4], 2, axis=-1), xp.repeat(action[..., 4:], 2, axis=-1)
    sign = np.array([1, -1, 1, -1, -1, 1, -1, 1], np.float32)
    return np.pi - np.pi / 4 * (extension + 1.5) + sign * np.pi / 4 * swing


def within(xp: Any, x: Any, most: Any) -> Any:
    """Return `x` clipped to ±`most`; in NumPy, where this runs for every substep, several times faster than its `clip`."""
    return xp.minimum(xp.maximum(x, -most), most)


def torque(xp: Any, error: Any, speed: Any, voltage: Any, viscosity: Any, kp: float, kd: float) -> tuple[Any, Any]:
    """Return the torques [N m] that motors exert and the ones they report, for an `error` of angle (actual minus commanded)
    and a `speed` [rad/s], on a battery of `voltage` with a `viscosity` [V s/rad] beside the back-EMF.
    """
    applied = within(xp, -kp * error - kd * speed, 1.0) * voltage
    reported = within(xp, TORQUE_CONSTANT / RESISTANCE * applied, MOST_OBSERVED)
    current = within(xp, applied - (TORQUE_CONSTANT + viscosity) * speed, MOST_VOLTS) / RESISTANCE
    return xp.sign(current) * xp.interp(xp.abs(current), CURRENTS, TORQUES), reported


@dataclasses.dataclass(frozen=True)
class MinitaurMotors:
    """A `Drive`: the motors' angles [8] to joint torques [8], every `timestep` seconds.

    Its memory [18] holds for how many substeps each motor has been hot, the torque that each reported last, and the battery's
    voltage and the viscosity. A motor that has shut down stays so: its count stands still.
    """

    timestep: float = 0.002
    overheat: bool = True
    kp: float = 1.0
    kd: float = 0.02

    def __call__(self, xp: Any, qpos: Any, qvel: Any, command: Any, memory: Any) -> tuple[Any, Any]:
        angle, speed = qpos[..., POSITIONS] * DIRECTION, qvel[..., SPEEDS] * DIRECTION
        hot, voltage, viscosity = memory[..., :MOTORS], memory[..., -2:-1], memory[..., -1:]
        reach, patience = FASTEST * self.timestep, round(PATIENCE / self.timestep)
        error = within(xp, angle - command, reach)
        exerted, reported = torque(xp, error, speed, voltage, viscosity, self.kp, self.kd)
        hot = xp.where(hot > patience, hot, (hot + 1) * (xp.abs(exerted) > HOT))
        controls = exerted * DIRECTION
        controls = controls * (hot <= patience) if self.overheat else controls
        return controls, xp.concatenate([hot, reported, voltage, viscosity], axis=-1)
