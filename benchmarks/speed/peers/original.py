"""An original-style loop on the Sawyer door: MuJoCo's C engine from Python, a NumPy replay, one seed per process."""

import time
from typing import Any

import jax
import mujoco
import numpy as np

from benchmarks.speed.peers.common import BATCH, CAPACITY, DOOR, emit, median_s, options, since_start
from benchmarks.speed.peers.learners import LEARNERS, Batch
from earl_jax import assets
from earl_jax.envs import make
from earl_jax.envs.sawyer.base import HAND_HIGH, HAND_LOW, OPENING, REACH

WARM_UP = 300


def original_scene() -> mujoco.MjModel:
    """Return our door with the geoms and collisions of the original: cylinders, split fingers, no pairs."""
    spec = mujoco.MjSpec.from_file(str(assets.mjcf(DOOR)))
    spec.option.iterations, spec.option.ls_iterations, spec.option.tolerance = 50, 50, 1e-10
    for pair in list(spec.pairs):
        spec.delete(pair)
    box = mujoco.mjtGeom.mjGEOM_BOX
    for side, inward in (("right", 0.003), ("left", -0.003)):
        finger = spec.geom(f"{side}_finger")
        finger.size, finger.pos = [0.045, 0.003, 0.015], [0, 0, 0]
        spec.body(f"{side}_claw").add_geom(name=f"{side}_pad", type=box, size=finger.size, pos=[0, inward, 0], mass=0)
    for name in ("bar", "grip", "stem"):
        spec.geom(name).type = mujoco.mjtGeom.mjGEOM_CYLINDER
    spec.delete(spec.geom("frame"))
    hard = "table", "palm", "right_finger", "right_pad", "left_finger", "left_pad", "panel", "bar", "grip", "stem"
    spec.joint("door").damping, spec.joint("door").armature = [2.0, 0.0, 0.0], 0.001
    for geom in [*map(spec.geom, hard), *spec.body("door").geoms]:
        geom.contype = geom.conaffinity = 1
    return spec.compile()


class Door:
    """The door with the geoms and collisions of the original: `obs [14]`, `action [4]`, 5 substeps per control step."""

    def __init__(self):
        task: Any = make(DOOR, engine="c")
        self.model, self.substeps, self.horizon = original_scene(), task.substeps, task.eval_horizon
        self.data, self.radius = mujoco.MjData(self.model), task.radius[task.variant]
        self.start, self.goal = jax.device_get(task.reset(jax.random.key(0)).data), np.asarray(task.goal_states[0])

    def reset(self) -> np.ndarray:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[: len(self.start.qpos)] = self.start.qpos
        self.data.mocap_pos[:], self.data.mocap_quat[:] = self.start.mocap_pos, self.start.mocap_quat
        mujoco.mj_forward(self.model, self.data)
        return self._obs()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool]:
        self.data.mocap_pos[0] = np.clip(self.data.mocap_pos[0] + REACH * action[:3], HAND_LOW, HAND_HIGH)
        self.data.ctrl[:] = action[3], -action[3]
        mujoco.mj_step(self.model, self.data, self.substeps)
        obs = self._obs()
        success = bool(np.linalg.norm(obs[4:7] - obs[11:]) <= self.radius)
        return obs, float(success), success

    def _obs(self) -> np.ndarray:
        hand, right, left, handle = self.data.sensordata.reshape(4, 3)
        grip = np.clip(np.linalg.norm(right - left) / OPENING, 0.0, 1.0)
        return np.concatenate([hand, [grip], handle, self.goal]).astype(np.float32)


class Training:
    """One seed: environment, learner and replay; `step` is one control step and one gradient step."""

    def __init__(self, learner: str):
        self.env, self.rng, self.count, self.age = Door(), np.random.default_rng(0), 0, 0
        self.obs = self.env.reset()
        self.learner = LEARNERS[learner](len(self.obs), 4)
        size = len(self.obs)
        self.replay = Batch(
            obs=np.zeros((CAPACITY, size), np.float32),
            action=np.zeros((CAPACITY, 4), np.float32),
            reward=np.zeros(CAPACITY, np.float32),
            terminal=np.zeros(CAPACITY, bool),
            next_obs=np.zeros((CAPACITY, size), np.float32),
        )

    def step(self, update: bool = True) -> None:
        action = self.learner.act(self.obs)
        following, reward, success = self.env.step(action)
        self.age += 1
        over = success or self.age >= self.env.horizon
        for column, value in zip(self.replay, (self.obs, action, reward, over, following), strict=True):
            column[self.count % CAPACITY] = value
        self.count += 1
        self.obs = following
        if over:
            self.obs, self.age = self.env.reset(), 0
        if update:
            rows = self.rng.integers(min(self.count, CAPACITY), size=BATCH)
            self.learner.update(Batch(*[column[rows] for column in self.replay]))

    def run(self, steps: int) -> None:
        """Make `steps` steps and wait for the last update."""
        for _ in range(steps):
            self.step()
        self.learner.finish()


def main() -> None:
    chosen = options(__doc__, learner={"choices": tuple(LEARNERS), "required": True})
    if chosen.learner == "torch":
        jax.config.update("jax_platforms", "cpu")
    training = Training(chosen.learner)
    start, began = since_start(), time.perf_counter()
    for _ in range(WARM_UP):
        training.step(update=training.count >= BATCH)
    training.run(chosen.steps)
    compiled = time.perf_counter() - began
    seconds = median_s(lambda: training.run(chosen.steps), chosen.repeats)
    threads = "; one thread of torch" if chosen.learner == "torch" and training.learner.device == "cpu" else ""
    emit(
        ("mujoco", *training.learner.packages), peer=f"original-style, {chosen.learner}", task=DOOR,
        device=training.learner.device, lanes=1,
        lane_steps_per_s=chosen.steps / seconds, start_s=start, compile_s=compiled,
        note=f"MuJoCo C on one core, the original's geoms; batch of {BATCH} from a NumPy replay of {CAPACITY:,}; compile_s "
        f"includes {WARM_UP + chosen.steps} warm-up steps{threads}",
    )  # fmt: skip


if __name__ == "__main__":
    main()
