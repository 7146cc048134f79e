"""Run the trained Minitaurs that ship in PyBullet's physics and in ours, and print one JSON line.

    pip install pybullet gym==0.23.1 "setuptools<81"
    python -m benchmarks.physics.minitaur_pybullet --out benchmarks/results/minitaur/pybullet.json

Robot, motors and randomisation are PyBullet's, with the settings of the released environment. There are no walls.
"""

import math
import types
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from benchmarks.output import emit
from earl_jax import Policy, pretrained, pretrained_info
from earl_jax.envs import make
from earl_jax.envs.minitaur.pen import GOALS
from earl_jax.metrics.comparison import permutation
from earl_jax.runs.numpy_policy import NumpyPolicy

TASK, METHOD = "minitaur_pen", "oracle"
TIPPED = 0.5
"""Cosine between the body's up axis and the vertical below which a robot counts as fallen: 60 degrees."""


class Bullet:
    """The released task in PyBullet, without walls: `reset(goal [2])` and `step(action [8])` return `obs [32]`."""

    def __init__(self) -> None:
        import pybullet
        import pybullet_data
        from pybullet_envs.bullet.minitaur import Minitaur
        from pybullet_envs.bullet.minitaur_env_randomizer import MinitaurEnvRandomizer
        from pybullet_utils.bullet_client import BulletClient

        self.client, data = BulletClient(connection_mode=pybullet.DIRECT), pybullet_data.getDataPath()
        self.client.setPhysicsEngineParameter(numSolverIterations=60)
        self.client.setTimeStep(0.002)
        self.client.setGravity(0, 0, -10)
        self.client.loadURDF(f"{data}/plane.urdf")
        self.robot = Minitaur(
            self.client, data, time_step=0.002, self_collision_enabled=True, motor_velocity_limit=150.0,
            accurate_motor_model_enabled=True, motor_overheat_protection=True,
        )  # fmt: skip
        self.randomizer = MinitaurEnvRandomizer()

    def reset(self, goal: np.ndarray) -> np.ndarray:
        self.goal = goal
        self.robot.Reset(reload_urdf=False)
        self.randomizer.randomize_env(types.SimpleNamespace(minitaur=self.robot))
        return self._hold(np.full(8, math.pi / 2), 100)

    def step(self, action: np.ndarray) -> np.ndarray:
        return self._hold(self.robot.ConvertFromLegModel(action), 5)

    def _hold(self, angles: np.ndarray, substeps: int) -> np.ndarray:
        for _ in range(substeps):
            self.robot.ApplyAction(angles)
            self.client.stepSimulation()
        observed = self.robot.GetObservation()
        return np.array([*observed[:28], *self.robot.GetBasePosition()[:2], *self.goal], np.float32)


def in_pybullet(policies: list[NumpyPolicy], goals: np.ndarray, steps: int) -> np.ndarray:
    """Return the observations [policies * G, steps, 32] of an episode of each policy with each of `goals [G, 2]`."""
    bullet = Bullet()

    def episode(policy, goal):
        obs = bullet.reset(goal)
        for _ in range(steps):
            yield (obs := bullet.step(policy(obs)))

    return np.array([list(episode(policy, goal)) for policy in policies for goal in goals])


def in_ours(policies: list[Policy], goals: np.ndarray, steps: int) -> np.ndarray:
    """Return what `in_pybullet` does, of our physics."""
    env = make(TASK)

    def episode(policy, key, goal):
        state = env.reset(key)
        state = env.make_state(state.data, state.obs[: env.state_size], {"goal": goal})

        def step(state, _):
            state = env.step(state, policy(state.obs))
            return state, state.obs

        return jax.lax.scan(step, state, None, steps)[1]

    keys = jax.random.split(jax.random.key(0), len(goals))
    run = jax.jit(jax.vmap(episode, (None, 0, 0)))
    return np.concatenate([run(policy, keys, goals) for policy in policies])


def measure(obs: np.ndarray) -> dict[str, Any]:
    """Return the measures of episodes `obs [E, T, 32]`."""
    env, up = make(TASK), 1 - 2 * (obs[..., 24] ** 2 + obs[..., 25] ** 2)
    reward, success = np.asarray(env.reward(obs), float), np.asarray(env.success(obs))
    reached, before = success.any(axis=1), success.cumsum(axis=1) == 0
    return {
        "success": reached.mean().round(3).item(),
        "fallen at the end": (up[:, -1] < TIPPED).mean().round(3).item(),
        "returns": reward.sum(axis=1).round(1).tolist(),
        "returns before the goal is reached": (reward * before).sum(axis=1)[reached].round(1).tolist(),
    }


def main(repeats: int = 2, steps: int = 1000, out: Path | None = None) -> None:
    """Compare `repeats` episodes of each policy with each goal, and write the comparison to `out`."""
    seeds = pretrained_info(TASK, METHOD)["seeds"]
    policies, goals = [pretrained(TASK, METHOD, seed) for seed in seeds], np.tile(GOALS, (repeats, 1))
    ours = measure(in_ours(policies, goals, steps))
    bullet = measure(in_pybullet([policy.numpy() for policy in policies], goals, steps))
    test = permutation(bullet["returns"], ours["returns"])._asdict()
    emit({"seeds": seeds, "ours": ours, "pybullet": bullet, "pybullet minus ours": test}, out)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
