"""The Minitaur's eight motors: before every substep, a position command becomes a voltage, a current and a torque.

Source: the "accurate" motor model of PyBullet's Minitaur, which the released EARL code enables. All angles have the
motors' sign; the joints of the left legs have the opposite sign (`DIRECTION`).
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

MOTORS = 8
DIRECTION = np.array([-1, -1, -1, -1, 1, 1, 1, 1], np.float32)
"""Sign of each motor relative to its joint. Legs: front left, back left, front right, back right; the left motor of
each first."""
POSITIONS, SPEEDS = slice(7, 23, 2), slice(6, 22, 2)
"""Indices of the motors in qpos and qvel; each is followed by the knee that it carries."""
DAMPING = 0.02
"""Share of the battery's voltage that acts against each rad/s of speed; the share for each radian of error is 1."""
RESISTANCE = 0.186
TORQUE_CONSTANT = 0.0954
"""Torque in N m per ampere, and back-EMF in volts per rad/s."""
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
LEAD, FULL, REPORTED = ((np.array(-limit), np.array(limit)) for limit in (MAX_LEAD, 1.0, MAX_REPORTED_TORQUE))
ZERO = np.array(0.0)


def torque(xp: Any, error: Any, speed: Any, voltage: Any, viscosity: Any) -> tuple[Any, Any]:
    """Return the torques [N m] that motors exert and the torques that they report.

    `error` is the actual minus the commanded angle [rad], `speed` is in rad/s, `voltage` is the battery's, and
    `viscosity` [V s/rad] adds to the back-EMF.
    """
    applied = xp.clip(-error - DAMPING * speed, -1.0, 1.0) * voltage
    reported = xp.clip(TORQUE_CONSTANT / RESISTANCE * applied, -MAX_REPORTED_TORQUE, MAX_REPORTED_TORQUE)
    current = xp.clip(applied - (TORQUE_CONSTANT + viscosity) * speed, -MAX_VOLTS, MAX_VOLTS) / RESISTANCE
    return xp.sign(current) * xp.interp(xp.abs(current), CURRENTS, TORQUES), reported


@dataclasses.dataclass(frozen=True)
class MinitaurMotors:
    """An `Actuator` that converts the motors' commanded angles [8] to joint torques [8], every `timestep` seconds.

    Its memory [18] contains, for each motor, the number of substeps for which it has been heating and the torque that
    it reported last, then the battery's voltage and the viscosity. A motor that has shut down keeps its count, and so
    stays off.
    """

    timestep: float = 0.002
    overheat: bool = True

    @property
    def max_hot(self) -> int:
        """Number of substeps of uninterrupted heating after which a motor shuts down."""
        return round(OVERHEAT_SECONDS / self.timestep)

    def __call__(self, xp: Any, qpos: Any, qvel: Any, command: Any, memory: Any) -> tuple[Any, Any]:
        angle, speed = qpos[..., POSITIONS] * DIRECTION, qvel[..., SPEEDS] * DIRECTION
        hot, voltage, viscosity = memory[..., :MOTORS], memory[..., -2:-1], memory[..., -1:]
        error = xp.clip(angle - command, -MAX_LEAD, MAX_LEAD)
        exerted, reported = torque(xp, error, speed, voltage, viscosity)
        hot = xp.where(hot > self.max_hot, hot, (hot + 1) * (xp.abs(exerted) > OVERHEAT_TORQUE))
        controls = exerted * DIRECTION
        controls = controls * (hot <= self.max_hot) if self.overheat else controls
        return controls, xp.concatenate([hot, reported, voltage, viscosity], axis=-1)

    def drive(
        self,
        qpos: np.ndarray,
        qvel: np.ndarray,
        ctrl: np.ndarray,
        command: np.ndarray,
        memory: np.ndarray,
        substeps: int,
        step: Callable[[], None],
    ) -> np.ndarray:
        """Return the memory [n, 18] after `substeps` calls of `step()` on the host, as `Actuator` describes.

        It computes with the joints' signs, because each function of the model is odd, and omits the limit of 50 V,
        because the torque is constant from 11 V on. Unless a motor can stop in this control step, heating is counted
        once, at the end. One lane then takes two thirds of the time that calls before every substep take.
        """
        angle, speed, target = qpos[:, POSITIONS], qvel[:, SPEEDS], command * DIRECTION
        hot, voltage, viscosity = memory[:, :MOTORS], memory[:, -2:-1], memory[:, -1:]
        amperes, back_emf = voltage / RESISTANCE, (TORQUE_CONSTANT + viscosity) / RESISTANCE
        torques, most = np.empty((substeps, *target.shape)), self.max_hot
        stopped = hot > most
        may_stop = ((hot > most - substeps) & ~stopped).any()
        for number in range(substeps):
            effort = _within(FULL, _within(LEAD, target - angle) - DAMPING * speed)
            exerted = np.interp(effort * amperes - back_emf * speed, SIGNED_CURRENTS, SIGNED_TORQUES)
            torques[number] = exerted
            if may_stop:
                hot = _heated(hot, stopped, exerted[None])
                stopped = hot > most
            ctrl[:] = exerted
            if self.overheat:
                np.copyto(ctrl, ZERO, where=stopped)
            step()
        hot = hot if may_stop else _heated(hot, stopped, torques)
        reported = _within(REPORTED, TORQUE_CONSTANT / RESISTANCE * effort * voltage)
        return np.concatenate([hot, reported * DIRECTION, memory[:, -2:]], axis=1)


def _heated(hot: np.ndarray, stopped: np.ndarray, torques: np.ndarray) -> np.ndarray:
    """Return the heating counts `hot [n, 8]` after k substeps of `torques [k, n, 8]`; `stopped` motors keep theirs."""
    cool = np.abs(torques) <= OVERHEAT_TORQUE
    since = cool[::-1].argmax(axis=0)
    return np.where(stopped, hot, np.where(cool.any(axis=0), since, hot + len(torques)))


def _within(limits: tuple[np.ndarray, np.ndarray], x: np.ndarray) -> np.ndarray:
    """Return `x`, clipped in place; `numpy.clip`, or limits that are not arrays, would take longer on few numbers."""
    return np.minimum(np.maximum(x, limits[0], out=x), limits[1], out=x)
