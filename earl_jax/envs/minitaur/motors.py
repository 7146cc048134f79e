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
MAX_LEAD = 0.3
"""Largest angle [rad] by which a command leads its motor: 150 rad/s over one of the original's substeps of 2 ms."""
OVERHEAT_TORQUE = 2.45
"""Torque [N m] above which a motor heats."""
OVERHEAT_SECONDS = 1.0
"""Uninterrupted seconds of heating after which a motor shuts down until the next reset."""
SIGNED_CURRENTS = np.concatenate([-CURRENTS[:0:-1], CURRENTS]).astype(np.float64)
SIGNED_TORQUES = np.concatenate([-TORQUES[:0:-1], TORQUES]).astype(np.float64)
ZERO, ONE, HEATING = np.array(0.0), np.array(1.0), np.array(OVERHEAT_TORQUE)


def _interval(limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Return -limit and limit as arrays."""
    return np.array(-limit), np.array(limit)


REPORTED = _interval(MAX_REPORTED_TORQUE)


def legs_to_motors(xp: Any, action: Any) -> Any:
    """Return the motors' angles [..., 8] for an `action [..., 8]` in leg space: 4 swings, 4 extensions, in [-1, 1].

    Source: the released leg model. An extension of 1 folds a leg, -1 stretches it.
    """
    swing, extension = xp.repeat(action[..., :4], 2, axis=-1), xp.repeat(action[..., 4:], 2, axis=-1)
    sign = np.array([1, -1, 1, -1, -1, 1, -1, 1], np.float32)
    return np.pi - np.pi / 4 * (extension + 1.5) + sign * np.pi / 4 * swing


def torque(xp: Any, error: Any, speed: Any, voltage: Any, viscosity: Any, kp: float, kd: float) -> tuple[Any, Any]:
    """Return the torques [N m] that motors exert and the torques that they report.

    `error` is the actual minus the commanded angle [rad], `speed` is in rad/s, `voltage` is the battery's, and
    `viscosity` [V s/rad] adds to the back-EMF.
    """
    applied = xp.clip(-kp * error - kd * speed, -1.0, 1.0) * voltage
    reported = xp.clip(TORQUE_CONSTANT / RESISTANCE * applied, -MAX_REPORTED_TORQUE, MAX_REPORTED_TORQUE)
    current = xp.clip(applied - (TORQUE_CONSTANT + viscosity) * speed, -MAX_VOLTS, MAX_VOLTS) / RESISTANCE
    return xp.sign(current) * xp.interp(xp.abs(current), CURRENTS, TORQUES), reported


class BoundMotors:
    """A `HostActuator` with the results of `MinitaurMotors`.

    It computes in the joints' signs, because each function of the model is odd. It omits the limit of 50 V, because the
    torque is constant from 11 V on. All operands are arrays, with which NumPy is several times faster on few motors than
    with Python's numbers, and a mask is copied, which is faster than a product with it.
    """

    def __init__(self, settings: "MinitaurMotors", qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray):
        self.angle, self.speed, self.ctrl = qpos[:, POSITIONS], qvel[:, SPEEDS], ctrl
        self.settings, self.max_hot = settings, np.array(float(settings.max_hot))
        self.max_lead, self.max_effort = _interval(MAX_LEAD), _interval(1.0 / settings.kp)
        self.effort, self.current, self.scratch = (np.empty(ctrl.shape) for _ in range(3))
        self.cools, self.stopped = np.empty(ctrl.shape, bool), np.empty(ctrl.shape, bool)
        self.damping, self.slowed = np.empty((2, *ctrl.shape)), np.empty((2, *ctrl.shape))

    def start(self, command: np.ndarray, memory: np.ndarray) -> None:
        self.target, self.hot, self.battery = command * DIRECTION, memory[:, :MOTORS].copy(), memory[:, -2:]
        self.volts = self.settings.kp * self.battery[:, :1]
        self.amperes = self.volts / RESISTANCE
        self.damping[0] = self.settings.kd / self.settings.kp
        self.damping[1] = (TORQUE_CONSTANT + self.battery[:, 1:]) / RESISTANCE
        np.greater(self.hot, self.max_hot, out=self.stopped)

    def apply(self) -> None:
        effort, current = self.effort, self.current
        np.multiply(self.speed, self.damping, out=self.slowed)
        np.subtract(self.target, self.angle, out=effort)
        _clip_in_place(effort, self.max_lead)
        np.subtract(effort, self.slowed[0], out=effort)
        _clip_in_place(effort, self.max_effort)
        np.multiply(effort, self.amperes, out=current)
        np.subtract(current, self.slowed[1], out=current)
        torque = np.interp(current, SIGNED_CURRENTS, SIGNED_TORQUES)
        self._heat(torque)
        if self.settings.overheat:
            np.copyto(torque, ZERO, where=self.stopped)
        self.ctrl[:] = torque

    def _heat(self, torque: np.ndarray) -> None:
        """Count the substeps of heating; the count of a motor that has shut down stays constant."""
        count = self.scratch
        np.abs(torque, out=count)
        np.less_equal(count, HEATING, out=self.cools)
        np.add(self.hot, ONE, out=count)
        np.copyto(count, ZERO, where=self.cools)
        np.copyto(count, self.hot, where=self.stopped)
        self.hot, self.scratch = count, self.hot
        np.greater(count, self.max_hot, out=self.stopped)

    def finish(self) -> np.ndarray:
        reported = TORQUE_CONSTANT / RESISTANCE * self.effort * self.volts
        _clip_in_place(reported, REPORTED)
        return np.concatenate([self.hot, reported * DIRECTION, self.battery], axis=1)


def _clip_in_place(x: np.ndarray, interval: tuple[np.ndarray, np.ndarray]) -> None:
    np.maximum(x, interval[0], out=x)
    np.minimum(x, interval[1], out=x)


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

    @property
    def max_hot(self) -> int:
        """Number of substeps of uninterrupted heating after which a motor shuts down."""
        return round(OVERHEAT_SECONDS / self.timestep)

    def __call__(self, xp: Any, qpos: Any, qvel: Any, command: Any, memory: Any) -> tuple[Any, Any]:
        angle, speed = qpos[..., POSITIONS] * DIRECTION, qvel[..., SPEEDS] * DIRECTION
        hot, voltage, viscosity = memory[..., :MOTORS], memory[..., -2:-1], memory[..., -1:]
        error = xp.clip(angle - command, -MAX_LEAD, MAX_LEAD)
        exerted, reported = torque(xp, error, speed, voltage, viscosity, self.kp, self.kd)
        hot = xp.where(hot > self.max_hot, hot, (hot + 1) * (xp.abs(exerted) > OVERHEAT_TORQUE))
        controls = exerted * DIRECTION
        controls = controls * (hot <= self.max_hot) if self.overheat else controls
        return controls, xp.concatenate([hot, reported, voltage, viscosity], axis=-1)

    def bind(self, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> BoundMotors:
        """Return the same motors for arrays of all lanes on the host, as `HostActuator` describes."""
        return BoundMotors(self, qpos, qvel, ctrl)
