"""Compare the Minitaur with stances and trots recorded in PyBullet, and print one JSON line.

    python -m benchmarks.physics.minitaur_trots reference.json --engine mjx --out benchmarks/results/minitaur/trots_mjx.json

The file has `after_reset` (pos, q: position of the base and the eight motor angles after the reset); `ext`, a list of
[extension, pos, q, ...] after two seconds with all legs at that extension; and `trot`, name to `par` (swing amplitude,
extension amplitude, Hz, mean extension, phase of the extension relative to the swing) and `traj`, a row per control step of base
position 3, orientation 4, motor angles 8 and more. Front left and back right legs are half a turn ahead of the other two.
`randomize` is off, because the recorded robot is the nominal one.
"""

import json
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro
from tyro.conf import Positional

from benchmarks.output import emit
from earl_jax import physics
from earl_jax.envs import make

HOLD = 200
"""Control steps of a stance: two seconds."""
CONTROL_STEP = 0.01
PHASES = np.array([0.0, np.pi, np.pi, 0.0])
FIRST = 50
"""Control steps over which motor angles are compared, before small differences accumulate."""
LEGS = ("front_left", "back_left", "front_right", "back_right")


def trot(par: list[float], steps: int) -> np.ndarray:
    """Return the open-loop actions [steps, 8] of a trot with the parameters of the file."""
    swing, extension, hertz, mean, lead = par
    phase = 2 * np.pi * hertz * CONTROL_STEP * np.arange(steps)[:, None] + PHASES
    return np.hstack([swing * np.sin(phase), mean + extension * np.sin(phase + lead)]).astype(np.float32)


def stance(extension: float, steps: int) -> np.ndarray:
    """Return the actions [steps, 8] that hold every leg at `extension`."""
    return np.tile(np.repeat([0.0, extension], 4), (steps, 1)).astype(np.float32)


def play(engine: str, actions: np.ndarray) -> np.ndarray:
    """Return qpos [lanes, steps, 23] of the nominal robot under `actions [lanes, steps, 8]`, one lane each."""
    env = make("minitaur_pen", engine=engine, randomize=False)
    state = env.reset(jax.random.key(0))

    def step(state, action):
        state = env.step(state, action)
        return state, state.data.qpos

    run = jax.jit(jax.vmap(lambda actions: jax.lax.scan(step, state, actions)[1]))
    return np.asarray(run(jnp.asarray(actions)))


def loop_error(paths: np.ndarray) -> float:
    """Return the largest distance [m] between the two halves of an ankle along `paths [..., 23]`."""
    model = physics.load_model("minitaur_pen")
    data, worst = mujoco.MjData(model), 0.0
    for qpos in paths.reshape(-1, paths.shape[-1]):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        for leg in LEGS:
            gap = data.site(f"ankle_{leg}_left").xpos - data.site(f"ankle_{leg}_right").xpos
            worst = max(worst, float(np.linalg.norm(gap)))
    return worst


def motors(qpos: np.ndarray) -> np.ndarray:
    """Return the motor angles [..., 8] of `qpos [..., 23]` in the motors' direction of rotation."""
    return qpos[..., 7::2] * np.repeat([-1.0, 1.0], 4)


def compare_trot(path: np.ndarray, recorded: np.ndarray) -> dict[str, Any]:
    """Return the differences between a trot's `path [steps, 23]` and the `recorded [steps, >= 15]` one."""
    moved, expected = path[-1, 0] - path[0, 0], recorded[-1, 0] - recorded[0, 0]
    angles, recorded_angles = motors(path[:FIRST]), recorded[:FIRST, 7:15]
    return {
        "displacement_m": round(float(moved), 4), "recorded_m": round(float(expected), 4),
        "ratio": round(float(moved / expected), 4),
        "height_rmse_mm": round(float(1e3 * np.sqrt(np.mean((path[:, 2] - recorded[:, 2]) ** 2))), 2),
        "motor_rmse_rad": round(float(np.sqrt(np.mean((angles - recorded_angles) ** 2))), 4),
    }  # fmt: skip


def report(file: Path, engine: str) -> dict[str, Any]:
    """Return the comparison of one file with one engine."""
    recording = json.loads(file.read_text())
    trots = {name: np.array(part["traj"]) for name, part in recording["trot"].items()}
    steps = max([HOLD, *map(len, trots.values())])
    actions = [stance(row[0], steps) for row in recording["ext"]]
    actions += [trot(recording["trot"][name]["par"], steps) for name in trots]
    paths = play(engine, np.stack(actions))
    held, walked = paths[: len(recording["ext"]), HOLD - 1], paths[len(recording["ext"]) :]
    rest = make("minitaur_pen", randomize=False).reset(jax.random.key(0)).data.qpos
    heights = [1e3 * (qpos[2] - row[1][2]) for qpos, row in zip(held, recording["ext"], strict=True)]
    angles = [np.abs(motors(qpos) - row[2]).max() for qpos, row in zip(held, recording["ext"], strict=True)]
    return {
        "env": "minitaur_pen", "file": file.name, "engine": engine,
        "reset_height_error_mm": round(1e3 * float(rest[2] - recording["after_reset"]["pos"][2]), 2),
        "stances": len(heights), "worst_height_error_mm": round(float(np.abs(heights).max()), 2),
        "worst_motor_error_rad": round(float(max(angles)), 4),
        "trots": {
            name: compare_trot(walked[number, : len(recorded)], recorded)
            for number, (name, recorded) in enumerate(trots.items())
        },
        "loop_error_mm": round(1e3 * loop_error(paths), 3),
    }  # fmt: skip


def main(file: Positional[Path], engine: Literal["c", "mjx", "warp"] = "c", out: Path | None = None) -> None:
    """Print the comparison, and write it to `out`."""
    emit(report(file, engine), out)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
