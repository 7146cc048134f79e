"""Make the starts that ship, to rounding: `python -m benchmarks.physics.starts NAME FILE.npz`.

NAME is a file of assets/starts: `cheetah_run`, or `sawyer_door` for the arm poses of the door's wide starts.
"""

import importlib
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.sawyer.base import REACH
from earl_jax.envs.sawyer.door import SawyerDoor
from earl_jax.physics import load_model

SETTLING = 200
"""Steps without torque that settle a start of the cheetah."""
STARTS = 512
TARGETS = np.array(
    [
        [-0.4, 0.45, 0.4], [-0.3, 0.7, 0.4], [-0.1, 0.6, 0.35], [0.0, 0.7, 0.4], [0.2, 0.6, 0.4], [0.25, 0.7, 0.38],
        [0.4, 0.5, 0.4], [0.4, 0.7, 0.35], [-0.45, 0.42, 0.1], [-0.48, 0.55, 0.12], [-0.4, 0.7, 0.1], [-0.35, 0.5, 0.2],
        [0.45, 0.45, 0.1], [0.48, 0.6, 0.08], [0.3, 0.42, 0.1], [0.2, 0.42, 0.22],
    ],
    np.float32,
)  # fmt: skip
"""Metres. The door with its handle sweeps the disc of 0.49 m about its hinge, right of x = -0.17, below z = 0.25: the hand
is outside of the disc, left of it or above."""
TRAVEL_HEIGHT = 0.42
RISING, CROSSING, SINKING = 40, 100, 600
"""Control steps in which the hand goes up, goes across, and goes down and comes to rest."""


def settled_cheetahs() -> dict[str, np.ndarray]:
    """Return `STARTS` settled starts as float32 `qpos, qvel, qacc_warmstart [n, 9]`.

    The suite's procedure: every limited joint is uniform in its range, the trunk has the model's pose, and MuJoCo's C
    engine takes 200 steps without torque from a cold start.
    """
    mujoco: Any = importlib.import_module("mujoco")
    model, random = load_model("cheetah_run"), np.random.default_rng(0)
    limited = model.jnt_limited.astype(bool)
    rows: dict[str, list[np.ndarray]] = {"qpos": [], "qvel": [], "qacc_warmstart": []}
    for _ in range(STARTS):
        data = mujoco.MjData(model)
        data.qpos[limited] = random.uniform(*model.jnt_range[limited].T)
        mujoco.mj_step(model, data, SETTLING)
        for field, values in rows.items():
            values.append(np.array(getattr(data, field)))
    return {field: np.asarray(values, np.float32) for field, values in rows.items()}


def resting_arms() -> dict[str, np.ndarray]:
    """Return the arm at rest at `TARGETS`, float32: `qpos [n, 9]`, mocap `target [n, 3]` and observed `hand [n, 3]`.

    The hand is all over its range, clear of the door at every angle.
    """
    env = SawyerDoor(engine="c")

    def to_rest(target):
        def step(state, number):
            above, across = jnp.append(state.obs[:2], TRAVEL_HEIGHT), jnp.append(target[:2], TRAVEL_HEIGHT)
            waypoint = jnp.where(number < RISING, above, jnp.where(number < RISING + CROSSING, across, target))
            move = (waypoint - state.data.mocap_pos[0]) / REACH
            return env.step(state, jnp.append(jnp.clip(move, -1.0, 1.0), -1.0)), None

        start = env.reset(jax.random.key(0))
        return jax.lax.scan(step, start, jnp.arange(RISING + CROSSING + SINKING))[0]

    states = jax.jit(jax.vmap(to_rest))(TARGETS)
    fields = {"qpos": states.data.qpos[:, :9], "target": states.data.mocap_pos[:, 0], "hand": states.obs[:, :3]}
    return {name: np.asarray(values, np.float32) for name, values in fields.items()}


if __name__ == "__main__":
    name, file = sys.argv[1:]
    np.savez_compressed(file, **{"cheetah_run": settled_cheetahs, "sawyer_door": resting_arms}[name]())
