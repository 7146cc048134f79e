"""Cheetah run: a planar cheetah learns to run at 10 m/s, the DeepMind Control Suite's `cheetah-run` without episodes.

Source: dm_control 1.0.50, `suite/cheetah`. The model is our own MJCF with the suite's numbers, equal up to
rounding. `python -m benchmarks.physics.starts cheetah_run FILE.npz` makes the starts.
"""

import dataclasses
import functools
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import assets
from earl_jax.envs.features import ContinuingDefaults
from earl_jax.envs.mujoco_env import MujocoEnv
from earl_jax.envs.shaping import linear, tolerance
from earl_jax.envs.state import NextState, State, random_row
from earl_jax.physics import EngineCost, PhysicsState

TARGET_SPEED = 10.0
"""Speed in metres per second at and above which the reward is 1."""
SLIDES = 2
"""Number of slide joints, forward and up; the seven hinges follow."""
POSITIONS = 8
"""Length of the observed position: all joints but the forward slide."""
LAP = 200.0
"""Metres after which the position along the track, which is not observed, wraps."""
HEIGHTS = (-1.0, 10.0)
"""Range in metres of the trunk's height, which is 0 at the start; outside this range the simulation broke."""


@dataclasses.dataclass(frozen=True)
class CheetahRun(MujocoEnv):
    """A planar cheetah runs (the paper's figure 2).

    `obs [17]` = height, pitch, 6 joint angles, then 9 velocities: forward and these 8; `action [6]` = torques.
    The task has no goal, so goals have length 0 and an observation is a state. The suite defines no success; here it is
    a speed of 10 m/s or more, where the suite's reward is 1. Starts are drawn from 512 states settled by the suite's
    procedure; the suite settles a new one for each episode. The position along the track wraps every 200 m; in the
    suite it grows without limit.
    """

    reward_type: str = "dense"
    train_horizon: int = 100_000
    eval_horizon: int = 1000

    name: ClassVar[str] = "cheetah_run"
    engine_cost: ClassVar[EngineCost | None] = EngineCost(host=0.027)
    state_size: ClassVar[int] = 17
    action_size: ClassVar[int] = 6
    goal_states: ClassVar[np.ndarray] = np.zeros((1, 0), np.float32)
    initial_states: ClassVar[np.ndarray] = np.zeros((1, 0), np.float32)
    continuing: ClassVar[ContinuingDefaults] = ContinuingDefaults(1000)
    control_step: ClassVar[float] = 0.01

    def reset(self, key: jax.Array) -> State:
        data = PhysicsState.at(**random_row(key, assets.starts(assets.asset_name(self))))
        return self.make_state(data, _observed(data), {"goal": jnp.zeros((0,))})

    def control(self, state: State, action: jax.Array) -> tuple[PhysicsState, jax.Array]:
        return state.data, action

    def observe(self, state: State, action: jax.Array, data: PhysicsState, sensors: jax.Array) -> NextState:
        ahead = data.qpos[0] - LAP * jnp.round(data.qpos[0] / LAP)
        data = data.replace(qpos=data.qpos.at[0].set(ahead))
        return data, _observed(data), {}

    @functools.cached_property
    def levers(self) -> tuple[np.ndarray, np.ndarray]:
        """The hinges that turn each link, bool [7, 7], and the link's lever, [7, 2]: metres (x, z) by which its
        rotation moves the whole cheetah's centre of mass."""
        model = self.simulator.mujoco_model()
        parents, total = model.body_parentid[1:] - 1, model.body_mass.sum()
        turned_by, levers = np.eye(len(parents), dtype=bool), model.body_mass[1:, None] * model.body_ipos[1:]
        for link, parent in list(enumerate(parents))[1:]:
            turned_by[link] |= turned_by[parent]
            levers[parent] += model.body_subtreemass[link + 1] * model.body_pos[link + 1]
        return turned_by, (levers[:, ::2] / total).astype(np.float32)

    def speed(self, obs: jax.Array) -> jax.Array:
        """Return the forward speed [...] of the whole cheetah's centre of mass in `obs [..., 17]`, metres per second.

        The suite reads the speed from a sensor that it updates after each step. The observation determines it, too.
        """
        turned_by, levers = self.levers
        angles = obs[..., None, SLIDES - 1 : POSITIONS] * turned_by
        rates = obs[..., None, POSITIONS + SLIDES : self.state_size] * turned_by
        angle, rate = angles.sum(axis=-1), rates.sum(axis=-1)
        moved = rate * (levers[:, 1] * jnp.cos(angle) - levers[:, 0] * jnp.sin(angle))
        return obs[..., POSITIONS] + moved.sum(axis=-1)

    def success(self, obs: jax.Array) -> jax.Array:
        return self.speed(obs) >= TARGET_SPEED

    def reward(self, obs: jax.Array) -> jax.Array:
        if self.sparse:
            return self.success(obs).astype(jnp.float32)
        return tolerance(self.speed(obs), TARGET_SPEED, jnp.inf, jnp.asarray(TARGET_SPEED), linear)

    def fault(self, state: State) -> jax.Array:
        height = state.data.qpos[1]
        return super().fault(state) | (height < HEIGHTS[0]) | (height > HEIGHTS[1])


def _observed(data: PhysicsState) -> jax.Array:
    """Return the state [17] of `data`: positions except the one along the track, then velocities."""
    return jnp.concatenate([data.qpos[1:], data.qvel])
