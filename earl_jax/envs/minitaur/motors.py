"""The Minitaur's eight motors: before every substep, a position command becomes a voltage, a current and a torque.

Source: the "accurate" motor model of PyBullet's Minitaur, which the released EARL code enables. All angles have the
motors' sign; the joints of the left legs have the opposite one (`DIRECTION`).
"""

import dataclasses
from typing import Any

import numpy as np

MOTORS = 8
DIRECTION = np.array([-1, -1, -1, -1, 1, 1, 1, 1], np.float32)
"""Sign of each motor relative to its joint. Legs: front left, back left, front right, back right; the left motor of
each first."""
POSITIONS, SPEEDS = slice(7, 23, 2), slice(6, 22, 2)
"""Indices of the motors in qpos and qvel; each is followed by the knee that it carries."""
RESISTANCE = 0.186
TORQUE_CONSTANT = 0.0954
"""N m per ampere, and volts per rad/s of back-EMF."""
MAX_VOLTS = 50.0
MAX_REPORTED_TORQUE = 5.7
CURRENTS = np.array([0, 10, 20, 30, 40, 50, 60], np.float32)
TORQUES = np.array([0, 1, 1.9, 2.45, 3.0, 3.25, 3.5], np.float32)
"""Saturation: torque [N m] by current [A], constant beyond the table."""
MAX_COMMAND_SPEED = 150.0
"""rad/s: a command may lead its motor by the angle that this speed covers in one substep."""
OVERHEAT_TORQUE = 2.45
"""Torque [N m] above which a motor heats."""
OVERHEAT_SECONDS = 1.0
"""Uninterrupted seconds of heating after which a motor shuts down until the next reset."""


def legs_to_motors(xp: Any, action: Any) -> Any:
    """Return the motors' angles [..., 8] for an `action [..., 8]` in leg space: 4 swings, 4 extensions, in [-1, 1].

    Source: the released leg model. An extension of 1 folds a leg, -1 stretches it.
    """
    swing, extension = xp.repeat(action[..., :4], 2, axis=-1), xp.repeat(action[..., 4:], 2, axis=-1)
    sign = np.array([1, -1, 1, -1, -1, 1, -1, 1], np.float32)
    return np.pi - np.pi / 4 * (extension + 1.5) + sign * np.pi / 4 * swing


def clipped(xp: Any, x: Any, limit: Any) -> Any:
    """Return `x` clipped to ±`limit`.

    NumPy runs this for every substep, where it is several times faster than `np.clip`.
    """
    return xp.minimum(xp.maximum(x, -limit), limit)


def torque(xp: Any, error: Any, speed: Any, voltage: Any, viscosity: Any, kp: float, kd: float) -> tuple[Any, Any]:
    """Return the torques [N m] that motors exert and the torques that they report.

    `error` is the actual minus the commanded angle [rad], `speed` is in rad/s, `voltage` is the battery's, and
    `viscosity` [V s/rad] adds to the back-EMF.
    """
    applied = clipped(xp, -kp * error - kd * speed, 1.0) * voltage
    reported = clipped(xp, TORQUE_CONSTANT / RESISTANCE * applied, MAX_REPORTED_TORQUE)
    current = clipped(xp, applied - (TORQUE_CONSTANT + viscosity) * speed, MAX_VOLTS) / RESISTANCE
    return xp.sign(current) * xp.interp(xp.abs(current), CURRENTS, TORQUES), reported


@dataclasses.dataclass(frozen=True)
class MinitaurMotors:
    """An `Actuator` that converts the motors' commanded angles [8] to joint torques [8], every `timestep` seconds.

    Its memory [18] holds, for each motor, the number of substeps that it has been heating and the torque that it
    reported last, then the battery's voltage and the viscosity. The count of a motor that has shut down stays constant,
    so it stays off.
    """

    timestep: float = 0.002
    overheat: bool = True
    kp: float = 1.0
    kd: float = 0.02

    def __call__(self, xp: Any, qpos: Any, qvel: Any, command: Any, memory: Any) -> tuple[Any, Any]:
        angle, speed = qpos[..., POSITIONS] * DIRECTION, qvel[..., SPEEDS] * DIRECTION
        hot, voltage, viscosity = memory[..., :MOTORS], memory[..., -2:-1], memory[..., -1:]
        max_error, max_hot = MAX_COMMAND_SPEED * self.timestep, round(OVERHEAT_SECONDS / self.timestep)
        error = clipped(xp, angle - command, max_error)
        exerted, reported = torque(xp, error, speed, voltage, viscosity, self.kp, self.kd)
        hot = xp.where(hot > max_hot, hot, (hot + 1) * (xp.abs(exerted) > OVERHEAT_TORQUE))
        controls = exerted * DIRECTION
        controls = controls * (hot <= max_hot) if self.overheat else controls
        return controls, xp.concatenate([hot, reported, voltage, viscosity], axis=-1)
