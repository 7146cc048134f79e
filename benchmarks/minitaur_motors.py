"""Time the Minitaur's motors inside MuJoCo beside the shipped ones: `python -m benchmarks.minitaur_motors --lanes 1 5 25`.

Each variant simulates a control step of the same rows in turn, in one process, as in `benchmarks.host_step`. The robot is the
nominal one. `ratio` is the median of the ratios to the first variant. The variants:

- `shipped`: one call for each substep, and the motors in NumPy before it.
- `dcmotor`: one call. Four MuJoCo dcmotors per joint add up to the torque table and the clipped lead; the limit of the voltage
  (duty cycle of 1) has no place in them. So the states of all substeps are recorded, and the exact motors then find the lanes at
  that limit, whose share is `inexact` and which a complete version would simulate again.
- `numba`: one call. A function compiled by numba is MuJoCo's control callback. Left out where numba is not installed.
"""

import argparse
import ctypes
import importlib.util
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import mujoco
import mujoco.batch
import numpy as np

from benchmarks.host_step import Advance, alternate, rows_of
from benchmarks.output import save
from earl_jax import assets
from earl_jax.envs import make
from earl_jax.envs.minitaur import motors
from earl_jax.envs.minitaur.pen import NOMINAL_VISCOSITY, NOMINAL_VOLTS
from earl_jax.machine import own_cores
from earl_jax.physics.engines import c
from earl_jax.physics.engines.simulations import STATE, Simulations
from earl_jax.report.tables import write

NAME, SUBSTEPS = "minitaur_pen", 5
SLOPES = {60: 0.025, 40: 0.03, 20: 0.035, 10: 0.01}
"""The torque table as a sum of clipped lines: amperes at which each is clipped, and its slope [N m / A]."""


def dcmotor_model() -> mujoco.MjModel:
    """Return the nominal robot with four dcmotors per motor, whose controls are joint angles."""
    constant = motors.TORQUE_CONSTANT + NOMINAL_VISCOSITY + motors.MinitaurMotors.kd * NOMINAL_VOLTS
    spec = mujoco.MjSpec.from_file(str(assets.mjcf(NAME)))
    joints, text = [actuator.target for actuator in spec.actuators], spec.to_xml()
    parts = [
        f'<dcmotor joint="{joint}" input="pos" motorconst="{constant} {constant}" '
        f'resistance="{constant * motors.RESISTANCE / slope}" saturation="{slope * limit} 0 0" '
        f'controller="{NOMINAL_VOLTS * slope / motors.RESISTANCE} 0 {constant * slope / motors.RESISTANCE} 0 0 '
        f'{motors.MAX_LEAD * NOMINAL_VOLTS}"/>'
        for joint in joints
        for limit, slope in SLOPES.items()
    ]
    before, rest = text.split("<actuator>")
    return mujoco.MjModel.from_xml_string(f"{before}<actuator>{''.join(parts)}{rest[rest.index('</actuator>') :]}")


class Dcmotors:
    """The control step with dcmotors; `inexact` collects the share of lanes at the limit of the voltage."""

    def __init__(self, simulations: Simulations, threads: int):
        self.simulations, count = simulations, simulations.batch.nsim
        self.batch = mujoco.batch.Batch(dcmotor_model(), count, threads)
        self.views = [self.batch.bind(field).reshape(count, -1) for field in (*STATE, "qacc_warmstart")]
        self.ctrl, self.inexact = self.batch.bind("ctrl"), list[float]()
        sizes = self.views[1].shape[1], self.views[2].shape[1]
        self.record = {
            field: np.zeros((count, SUBSTEPS, size)) for field, size in zip(("qpos", "qvel"), sizes, strict=True)
        }

    def advance(self, rows: np.ndarray) -> np.ndarray:
        for view, (_, columns) in zip([v for v in self.views if v.size], self.simulations.inputs, strict=False):
            view[:] = rows[:, columns]
        command = rows[:, self.simulations.command].astype(np.float64)
        memory = rows[:, self.simulations.memory].astype(np.float64)
        before = [self.views[1].copy(), self.views[2].copy()]
        self.ctrl[:] = np.repeat(command * motors.DIRECTION, len(SLOPES), axis=1)
        after = self.batch.rollout(SUBSTEPS, record=("qpos", "qvel"), out=self.record).values()
        states = [
            np.concatenate([first[:, None], part[:, :-1]], axis=1) for first, part in zip(before, after, strict=True)
        ]
        return np.concatenate([*self.views, self._check(*states, command, memory)], axis=1, dtype=np.float32)

    def _check(self, qpos: np.ndarray, qvel: np.ndarray, command: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Return the memory after the substeps that start at `qpos [n, SUBSTEPS, nq]` and `qvel`."""
        actuator = motors.MinitaurMotors()
        torques, after = actuator(np, qpos, qvel, command[:, None], np.repeat(memory[:, None], SUBSTEPS, axis=1))
        error = motors.clipped(np, qpos[..., motors.POSITIONS] - (command * motors.DIRECTION)[:, None], motors.MAX_LEAD)
        effort = np.abs(error + actuator.kd * qvel[..., motors.SPEEDS])
        self.inexact.append(float((effort > 1.0).any(axis=(1, 2)).mean()))
        hot, heats = memory[:, : motors.MOTORS], np.abs(torques) > motors.OVERHEAT_TORQUE
        for substep in range(SUBSTEPS):
            hot = np.where(hot > actuator.max_hot, hot, (hot + 1) * heats[:, substep])
        return np.concatenate([hot, after[:, -1, motors.MOTORS :]], axis=1)


def pointer_index(data: Any, field: str) -> int:
    """Return the index of the pointer to `field` in `mjData`, in units of eight bytes."""
    words = (ctypes.c_uint64 * 60_000).from_address(data._address)
    return next(index for index, word in enumerate(words) if word == getattr(data, field).ctypes.data)


def compiled_motors(model: mujoco.MjModel) -> Any:
    """Return the nominal motors as a numba function of C; userdata holds the command and the memory of a lane."""
    numba = importlib.import_module("numba")
    data = mujoco.MjData(model)
    i_qpos, i_qvel, i_ctrl, i_user = (pointer_index(data, field) for field in ("qpos", "qvel", "ctrl", "userdata"))
    constant, resistance = motors.TORQUE_CONSTANT, motors.RESISTANCE
    types, pointer = numba.types, numba.types.CPointer

    @numba.cfunc(types.void(pointer(types.uint64), pointer(pointer(types.float64))))
    def control(_, data):
        qpos, qvel, ctrl, user = data[i_qpos], data[i_qvel], data[i_ctrl], data[i_user]
        for motor in range(8):
            sign = -1.0 if motor < 4 else 1.0
            speed = sign * qvel[6 + 2 * motor]
            error = min(max(sign * qpos[7 + 2 * motor] - user[motor], -0.3), 0.3)
            volts = min(max(-error - 0.02 * speed, -1.0), 1.0) * user[24]
            current = (volts - (constant + user[25]) * speed) / resistance
            size = abs(current)
            torque = 0.025 * min(size, 60.0) + 0.03 * min(size, 40.0) + 0.035 * min(size, 20.0) + 0.01 * min(size, 10.0)
            hot = user[8 + motor]
            if hot <= 500:
                hot = hot + 1.0 if torque > 2.45 else 0.0
            user[8 + motor] = hot
            user[16 + motor] = min(max(constant / resistance * volts, -5.7), 5.7)
            ctrl[motor] = 0.0 if hot > 500 else sign * (torque if current > 0 else -torque)

    return control


def callback_variable() -> ctypes.c_void_p:
    """Return MuJoCo's variable for its control callback; None in it means no callback."""
    library = next(Path(mujoco.__file__).parent.glob("libmujoco.so*"))
    return ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_control")


def numba_motors(simulations: Simulations, threads: int) -> Advance:
    """Return the control step with motors that numba compiled."""
    spec, count = mujoco.MjSpec.from_file(str(assets.mjcf(NAME))), simulations.batch.nsim
    spec.nuserdata = motors.MOTORS + 18
    model = spec.compile()
    began = time.perf_counter()
    control = compiled_motors(model)
    print(f"numba: {time.perf_counter() - began:.1f} s to import and to compile", flush=True)
    batch = mujoco.batch.Batch(model, count, threads)
    views = [batch.bind(field).reshape(count, -1) for field in (*STATE, "qacc_warmstart")]
    user, callback = batch.bind("userdata"), callback_variable()

    def advance(rows: np.ndarray) -> np.ndarray:
        for view, (_, columns) in zip([v for v in views if v.size], simulations.inputs, strict=False):
            view[:] = rows[:, columns]
        user[:, : motors.MOTORS] = rows[:, simulations.command]
        user[:, motors.MOTORS :] = rows[:, simulations.memory]
        callback.value = control.address
        batch.step(nstep=SUBSTEPS)
        callback.value = None
        return np.concatenate([*views, user[:, motors.MOTORS :]], axis=1, dtype=np.float32)

    return advance


def measure(lanes: int, repeats: int, pause: float) -> list[dict[str, Any]]:
    """Return a row of the table for each variant."""
    env = make(NAME, engine="c", randomize=False)
    rows = rows_of(env, lanes)
    host = c.host_of(env.simulator, env.reset(jax.random.key(0)).data.memory.size)
    threads = c.WorkerPool(host, len(own_cores()))._threads(lanes)
    simulations = host.simulations(lanes, threads)
    dcmotors = Dcmotors(simulations, threads)
    steps: dict[str, Callable] = {"shipped": simulations.advance, "dcmotor": dcmotors.advance}
    if importlib.util.find_spec("numba"):
        steps["numba"] = numba_motors(simulations, threads)
    times = alternate(steps, rows, repeats, pause)
    inexact = {"dcmotor": round(statistics.mean(dcmotors.inexact), 4)}
    expected, first = steps["shipped"](rows), np.array(times["shipped"])
    return [
        {
            "lanes": lanes, "cores": len(own_cores()), "threads": threads, "variant": variant,
            "ms": round(1e3 * statistics.median(seconds), 4), "fastest_ms": round(1e3 * min(seconds), 4),
            "ratio": round(float(np.median(np.array(seconds) / first)), 3),
            "largest_qpos_difference": float(np.abs(steps[variant](rows) - expected)[:, 1:24].max()),
            "inexact": inexact.get(variant, 0.0),
        }
        for variant, seconds in times.items()
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, nargs="+", default=[1, 5, 25])
    parser.add_argument("--repeats", type=int, default=300)
    parser.add_argument("--pause-us", type=float, default=200.0)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/physics/minitaur_motors"))
    arguments = parser.parse_args()
    table: list[dict[str, Any]] = []
    for lanes in arguments.lanes:
        table += measure(lanes, arguments.repeats, 1e-6 * arguments.pause_us)
        print(*table[-3:], sep="\n", flush=True)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    write(table, arguments.out.with_suffix(".csv"))
    lanes = " ".join(map(str, arguments.lanes))
    command = f"python -m benchmarks.minitaur_motors --lanes {lanes} --pause-us {arguments.pause_us:g}"
    save(arguments.out.with_suffix(".json"), command, {"rows": table})


if __name__ == "__main__":
    main()
