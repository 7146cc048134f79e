"""Tabletop organization: a gripper carries a mug to one of four coasters and returns home.

Source: Sharma et al. 2022, section 5 and appendix; numbers and rewards follow the released `TabletopManipulation`.
The original writes positions and integrates no forces, so this task is plain arithmetic without a physics engine.
"""

import dataclasses
from collections.abc import Iterator
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import assets
from earl_jax.envs.base import KinematicEnv
from earl_jax.envs.demonstrations import DemoScript, DemoStart, TaskDemos
from earl_jax.envs.features import ContinuingDefaults, Map, Starts, View
from earl_jax.envs.state import NextState, State
from earl_jax.physics import PhysicsState

STEP = 0.2
REACH = 0.4
GRASP = 0.32
"""Distance to the mug at which the scripted expert grips. With a larger distance, the gripper would hit the wall before
the mug reaches a far coaster."""
LIMIT = 2.8
TOLERANCE = 0.2
FREE = np.array([-1.0, -1.0], np.float32)
HELD = np.array([0.0, 0.0], np.float32)
HOME = np.array([0.0, 0.0, 2.5, 0.0], np.float32)
COASTERS = np.array([[-2.5, -1.0], [-2.5, 1.0], [0.0, 2.0], [0.0, -2.0]], np.float32)
GOALS = np.concatenate([np.zeros((4, 2), np.float32), COASTERS, np.tile(FREE, (4, 1))], axis=1)
"""The task goals: the gripper at home, the mug on a coaster, and not held."""
DEMOS_PER_GOAL = 3
DEMO_SPEED = 0.5
"""Share of the full speed at which the demonstration script moves, as in the released demonstrations."""
PLACED = 0.1
"""Largest distance of the mug from its goal at which the scripts release it, in table units."""
DEMO_AXIS_TOLERANCE = 0.05
"""Distance along x below which the demonstration script moves along y."""
WIDE_RANGE = 2.5
WIDE_CLEARANCE = 1.0
WIDE_TRIES = 64


@dataclasses.dataclass(frozen=True)
class TabletopOrganization(KinematicEnv):
    """A gripper takes a mug to a coaster and returns.

    `obs [12]` = gripper 2, mug 2, held flag 2, goal 6; `action [3]` = dx, dy, grip.
    A step moves the gripper by up to 0.2 along each axis. `grip > 0` holds a mug nearer than 0.4. Success: the joint
    distance of gripper and mug to the goal is at most 0.2. `wide=True` is the released option `wide_init_distr`:
    gripper and mug start anywhere, the mug at least 1 from the gripper and from each coaster, and success counts the
    mug alone.
    """

    wide: bool = False
    mug_only: bool = False
    """Whether success counts the mug alone, as in the paper's main text; the appendix and the release count the gripper
    too."""

    name: ClassVar[str] = "tabletop_organization"
    state_size: ClassVar[int] = 6
    action_size: ClassVar[int] = 3
    goal_states: ClassVar[np.ndarray] = GOALS
    initial_states: ClassVar[np.ndarray] = np.concatenate([HOME, FREE])[None]
    continuing: ClassVar[ContinuingDefaults] = ContinuingDefaults(400, train_horizon=50_000)

    def reset(self, key: jax.Array) -> State:
        start_key, goal_key = jax.random.split(key)
        qpos = self._wide_start(start_key) if self.wide else jnp.asarray(HOME)
        return self._state_at(jnp.concatenate([qpos, FREE]), self.sample_goal(goal_key))

    @property
    def starts(self) -> Starts:
        """Uniform and wide starts with gripper and mug anywhere on the table; every place is within reach."""
        return Starts(self._uniform_start, self._uniform_start if self.sparse else None)

    def _uniform_start(self, key: jax.Array) -> State:
        start_key, goal_key = jax.random.split(key)
        qpos = jax.random.uniform(start_key, (4,), minval=-LIMIT, maxval=LIMIT)
        return self._state_at(jnp.concatenate([qpos, FREE]), self.sample_goal(goal_key))

    def _state_at(self, vector: jax.Array, goal: jax.Array) -> State:
        """Return the state with the state vector `vector [6]` and the goal `goal [6]`."""
        return self.make_state(PhysicsState.at(vector[:4]), vector, {"goal": goal})

    def object_position(self, state: State) -> jax.Array:
        """Return the mug's x, y [2] in `state`, table units."""
        return state.data.qpos[2:]

    @property
    def map(self) -> Map:
        """The gripper's positions, and those of gripper and mug at the start and at the goals: home and the coasters.

        With `wide`, starts can be anywhere, so none are listed.
        """
        return Map(
            position=lambda obs: obs[..., :2],
            bounds=np.array([[-LIMIT, -LIMIT], [LIMIT, LIMIT]], np.float32),
            unit="table units",
            starts=None if self.wide else HOME.reshape(2, 2),
            goals=np.concatenate([HOME[None, :2], COASTERS]),
        )

    @property
    def view(self) -> View:
        return View(assets.asset_name(self), render_goal=self._at_goal)

    def _at_goal(self, state: State) -> PhysicsState:
        return state.data.replace(qpos=state.info["goal"][:4])

    def _wide_start(self, key: jax.Array) -> jax.Array:
        """Return the first of 64 uniform draws [4] with the required distances; about half have them (none: 1e-17)."""
        draws = jax.random.uniform(key, (WIDE_TRIES, 4), minval=-WIDE_RANGE, maxval=WIDE_RANGE)
        apart = jnp.linalg.norm(draws[:, :2] - draws[:, 2:], axis=-1) >= WIDE_CLEARANCE
        clear = jnp.linalg.norm(draws[:, None, 2:] - COASTERS, axis=-1) >= WIDE_CLEARANCE
        return draws[jnp.argmax(apart & clear.all(-1))]

    def transition(self, state: State, action: jax.Array) -> NextState:
        gripper, mug, flag = state.data.qpos[:2], state.data.qpos[2:], state.obs[4:6]
        near = jnp.linalg.norm(gripper - mug) < REACH
        held = (action[2] > 0) & (near | (flag[0] == HELD[0]))
        moved = jnp.clip(gripper + STEP * action[:2], -LIMIT, LIMIT)
        carried = jnp.clip(mug + (moved - gripper), -LIMIT, LIMIT)
        qpos = jnp.concatenate([moved, jnp.where(held, carried, mug)])
        return state.data.replace(qpos=qpos), jnp.concatenate([qpos, jnp.where(held, HELD, FREE)]), {}

    def success(self, obs: jax.Array) -> jax.Array:
        first = 2 if self.wide or self.mug_only else 0
        return jnp.linalg.norm(obs[..., first:4] - obs[..., 6 + first : 10], axis=-1) <= TOLERANCE

    def reward(self, obs: jax.Array) -> jax.Array:
        if self.sparse:
            return self.success(obs).astype(jnp.float32)
        to_goal = jnp.linalg.norm(obs[..., 2:4] - obs[..., 8:10], axis=-1)
        to_mug = 0.5 * jnp.linalg.norm(obs[..., :2] - obs[..., 2:4], axis=-1)
        bonus = 2.0 * jnp.exp(-(to_goal**2) / 0.01) + 0.5 * jnp.exp(-(to_mug**2) / 0.01)
        return -to_goal - to_mug + bonus

    @property
    def demonstrations(self) -> TaskDemos:
        script = DemoScript(noise=0.1, starts=self._demo_starts, action=self._demo_action)
        return dataclasses.replace(super().demonstrations, expert=self._expert, script=script, state_at=self._state_at)

    def _expert(self, obs: jax.Array) -> jax.Array:
        """Return the action [3] of the fastest script, at full speed on both axes: fetch the mug, carry it, return."""
        target, grip = _waypoint(obs)
        move = jnp.clip((target - obs[:2]) / STEP, -1.0, 1.0)
        return jnp.concatenate([move, grip[None]])

    def _demo_action(self, obs: np.ndarray) -> np.ndarray:
        """Return the action [3] of the demonstration script: the expert's waypoint at half speed, x before y."""
        target, grip = _waypoint(obs)
        offset = np.asarray(target) - obs[:2]
        axis = 0 if abs(offset[0]) > DEMO_AXIS_TOLERANCE else 1
        move = np.zeros(2)
        move[axis] = np.clip(offset[axis] / STEP, -DEMO_SPEED, DEMO_SPEED)
        return np.append(move, grip)

    def _demo_starts(self, seed: int) -> Iterator[DemoStart]:
        """Yield three starts for each goal; a backward demonstration starts where its forward one ended."""
        for goal in np.repeat(self.goal_states, DEMOS_PER_GOAL, axis=0):
            start = self.with_goal(self.reset(jax.random.key(seed)), jnp.asarray(goal))
            yield DemoStart(forward=start, backward=None, backward_goal=self.initial_states[0])


@jax.jit
def _waypoint(obs: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the gripper's next target [2] for `obs [12]` and its grip: hold (1) or release (-1)."""
    gripper, mug, goal_gripper, goal_mug = obs[:2], obs[2:4], obs[6:8], obs[8:10]
    placed = jnp.linalg.norm(mug - goal_mug) <= PLACED
    near = jnp.linalg.norm(gripper - mug) < GRASP
    held = obs[4] == HELD[0]
    carry = gripper + (goal_mug - mug)
    grip = ~placed & (near | held)
    return jnp.where(placed, goal_gripper, jnp.where(grip, carry, mug)), jnp.where(grip, 1.0, -1.0)
