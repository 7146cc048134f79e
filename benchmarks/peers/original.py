"""An original-style loop on the Sawyer door: MuJoCo's C engine from Python, a NumPy replay, one seed a process."""

import time
from typing import Any

import jax
import mujoco
import numpy as np

from benchmarks.peers.common import BATCH, CAPACITY, DOOR, median_s, options, since_start, tell
from benchmarks.peers.learners import LEARNERS, Batch
from benchmarks.physics import original_style
from earl_jax.envs import make
from earl_jax.envs.sawyer.base import HAND_HIGH, HAND_LOW, OPENING, REACH

WARM_UP = 300


class Door:
    """The door with the original's shapes and collisions: `obs [14]`, `action [4]`, 5 substeps a control step."""

    def __init__(self):
        task: Any = make(DOOR, physics="c")
        self.model, self.substeps, self.horizon = original_style(DOOR), task.substeps, task.eval_horizon
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


class Life:
    """One seed: the world, its learner and its replay; `step` is one control step and one gradient step."""

    def __init__(self, learner: str):
        self.world, self.rng, self.count, self.age = Door(), np.random.default_rng(0), 0, 0
        self.obs = self.world.reset()
        self.learner = LEARNERS[learner](len(self.obs), 4)
        size, sizes = len(self.obs), (CAPACITY,)
        self.replay = Batch(
            np.zeros((*sizes, size), np.float32), np.zeros((*sizes, 4), np.float32), np.zeros(sizes, np.float32),
            np.zeros(sizes, bool), np.zeros((*sizes, size), np.float32),
        )  # fmt: skip

    def step(self, learn: bool = True) -> None:
        action = self.learner.act(self.obs)
        following, reward, success = self.world.step(action)
        self.age += 1
        over = success or self.age >= self.world.horizon
        for column, value in zip(self.replay, (self.obs, action, reward, over, following), strict=True):
            column[self.count % CAPACITY] = value
        self.count += 1
        self.obs = following
        if over:
            self.obs, self.age = self.world.reset(), 0
        if learn:
            rows = self.rng.integers(min(self.count, CAPACITY), size=BATCH)
            self.learner.learn(Batch(*[column[rows] for column in self.replay]))

    def live(self, steps: int) -> None:
        """Take `steps` steps and wait for the last update."""
        for _ in range(steps):
            self.step()
        self.learner.finish()


def main() -> None:
    chosen = options(__doc__, learner={"choices": tuple(LEARNERS), "required": True})
    if chosen.learner == "torch":
        jax.config.update("jax_platforms", "cpu")
    life = Life(chosen.learner)
    start, began = since_start(), time.perf_counter()
    for _ in range(WARM_UP):
        life.step(learn=life.count >= BATCH)
    life.live(chosen.steps)
    compiled = time.perf_counter() - began
    seconds = median_s(lambda: life.live(chosen.steps), chosen.repeats)
    alone = "; one thread of torch" if chosen.learner == "torch" and life.learner.device == "cpu" else ""
    tell(
        ("mujoco", *life.learner.packages), peer=f"original-style, {chosen.learner}", task=DOOR, device=life.learner.device,
        processes=1, lanes=1, lane_steps_per_s=chosen.steps / seconds, start_s=start, compile_s=compiled,
        note=f"MuJoCo C on one core, the original's shapes; batch of {BATCH} from a NumPy replay of {CAPACITY:,}; compile_s "
        f"holds {WARM_UP + chosen.steps} warm-up steps{alone}",
    )  # fmt: skip


if __name__ == "__main__":
    main()
