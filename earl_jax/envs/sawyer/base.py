"""The base class of both Sawyer tasks: an arm dragged by its hand, two fingers, an object, 14 numbers of observation.

Source: the released EARL environments on Meta-World's `SawyerXYZEnv` of July 2021. The physics are our own MJCF
(assets/mjcf), fitted to the recorded demonstrations; docs/tasks.md lists every difference.
"""

import abc
import dataclasses
from collections.abc import Iterator
from typing import ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.assets import Demos
from earl_jax.envs.demonstrations import DemoScript, DemoStart, TaskDemos
from earl_jax.envs.mujoco_env import MujocoEnv, leashed_target
from earl_jax.envs.state import NextState, State
from earl_jax.physics import PhysicsState

REACH = 0.01
"""Metres that the mocap target moves for an action of 1."""
HAND_LOW = np.array([-0.5, 0.4, 0.05], np.float32)
HAND_HIGH = np.array([0.5, 1.0, 0.5], np.float32)
POINTING_DOWN = np.array([1.0, 0.0, 1.0, 0.0], np.float32) / np.float32(np.sqrt(2.0))
OPENING = 0.1
"""Metres between the finger tips at which the observed gripper opening is 1."""
RELEASED_SIZE, GRIPPER = 7, 3
"""Length of a released state, and the index of the gripper's opening in it; `variant="paper"` omits it."""
ARM = 9
"""Number of joints of the arm and the fingers; the object's joints follow."""
WRIST = 6
"""Index of the arm's last joint, which rotates the hand in position."""
JOINT_SPEED = np.array([2.8, 3.6], np.float32)
LEASH = np.array([0.38, 0.03], np.float32)
"""Metres by which the mocap target may lead the hand while the fastest joint before the wrist turns at `JOINT_SPEED`
[rad/s]; linear between. A difference from the original, where a hand that slips off the handle with its target half a
metre away reaches 9 m/s, 22 mm per substep, and passes through the next obstacle. The recordings stay below 0.36 m and
2.8 rad/s, where the limit has no effect."""


class Pose(NamedTuple):
    """The arm after a reset: mocap `target [3]`, joint `qpos, qvel, warmstart [9]`, observed `hand [3]` and `grip`.

    The fields are tuples and numbers, or arrays. The original simulates 250 substeps at every reset, after which the
    arm is not yet at rest; the poses are the resulting states.
    """

    target: tuple[float, ...] | jax.Array
    qpos: tuple[float, ...] | jax.Array
    qvel: tuple[float, ...] | jax.Array
    warmstart: tuple[float, ...] | jax.Array
    hand: tuple[float, ...] | jax.Array
    grip: float


@dataclasses.dataclass(frozen=True)
class Sawyer(MujocoEnv):
    """An arm and an object: `obs [14]` = hand 3, gripper opening 1, object 3, goal 7; `action [4]` = dx, dy, dz, grip.

    A step moves the mocap target by up to 1 cm along each axis; `grip` +1 closes, -1 opens. `reset_at_goal` starts at
    the task's goal, like the released option for backward evaluations and demonstrations. The released 5 `substeps`
    are 2.5 ms each.

    The paper's text contradicts itself: it says 12 numbers, as `variant="paper"` observes, but also lists the gripper's
    opening, which makes 14. It calls `grip` a torque; here, as released, `grip` sets the targets of the fingers'
    position actuators.
    """

    substeps: int = 5
    variant: Literal["released", "paper"] = "released"
    """The released observation of 14 numbers, or the 12 of the paper's text, without the gripper."""
    reset_at_goal: bool = False

    action_size: ClassVar[int] = 4
    control_step: ClassVar[float] = 0.0125
    demo_count: ClassVar[int]
    """Number of scripted demonstrations in each direction, from the paper's table."""
    radius: ClassVar[dict[str, float]]
    """Largest distance [m] of the object to its goal that counts as success, for each variant."""
    released_goals: ClassVar[np.ndarray]
    """The goals [G, 7] as released."""
    released_starts: ClassVar[np.ndarray]
    """The initial states [I, 7] as released."""
    object_low: ClassVar[np.ndarray]
    object_high: ClassVar[np.ndarray]
    """The box [m] of the object's positions; if the object is outside, the simulation broke."""

    @property
    def observed_indices(self) -> np.ndarray:
        """Indices of the numbers of the released state [7] that this variant observes."""
        return np.delete(np.arange(RELEASED_SIZE), [] if self.variant == "released" else GRIPPER)

    @property
    def state_size(self) -> int:
        return len(self.observed_indices)

    @property
    def goal_states(self) -> np.ndarray:
        """Task goals; with `reset_at_goal` these are the released initial states, as in `reset`."""
        return (self.released_starts if self.reset_at_goal else self.released_goals)[:, self.observed_indices]

    @property
    def initial_states(self) -> np.ndarray:
        """Representative states of rho; with `reset_at_goal` these are the released goals."""
        return (self.released_goals if self.reset_at_goal else self.released_starts)[:, self.observed_indices]

    @property
    @abc.abstractmethod
    def pose(self) -> Pose:
        """The arm's pose after a reset."""

    @abc.abstractmethod
    def joints_at(self, position: jax.Array) -> jax.Array:
        """Return the object's joints [j] that put its observed position at `position [3]`."""

    @property
    def demonstrations(self) -> TaskDemos:
        """The demonstrations; `reset_at_goal` exchanges the recorded directions, but not those of the script."""
        script = DemoScript(noise=0.2, starts=dataclasses.replace(self, reset_at_goal=False)._demo_starts)
        return dataclasses.replace(
            super().demonstrations,
            layout=self._observed_demos,
            exchanged=self.reset_at_goal,
            expert=self._expert,
            script=script,
            state_at=None if self.reset_at_goal else self._demonstrated_state,
        )

    @abc.abstractmethod
    def _expert(self, obs: jax.Array) -> jax.Array:
        """Return the action [4] of a script that reaches the goal in `obs [o]`."""

    def _demonstrated_state(self, vector: jax.Array, goal: jax.Array) -> State:
        position = vector[-3:]
        return self.start_at(self.joints_at(position), position, goal)

    def _at_goal(self, state: State) -> PhysicsState:
        object_joints = self.joints_at(state.info["goal"][-3:])
        return state.data.replace(qpos=jnp.concatenate([state.data.qpos[:ARM], object_joints]))

    def start_at(
        self, joints: jax.Array, position: jax.Array, goal: jax.Array, arm: Pose | None = None, **info: jax.Array
    ) -> State:
        """Return the state with the object at `joints [j]`, observed at `position`, and the arm in its reset pose.

        `arm` gives another pose, whose fields can be arrays; `info` adds fields to the state's `info`.
        """
        pose, rest = arm or self.pose, jnp.zeros_like(joints)

        def join(arm, rest):
            return jnp.concatenate([jnp.asarray(arm, jnp.float32), rest])

        data = PhysicsState.at(
            qpos=join(pose.qpos, joints),
            qvel=join(pose.qvel, rest),
            mocap_pos=jnp.asarray([pose.target], jnp.float32),
            mocap_quat=jnp.asarray(POINTING_DOWN)[None],
            qacc_warmstart=join(pose.warmstart, rest),
        )
        vector = jnp.concatenate([jnp.asarray([*pose.hand, pose.grip], jnp.float32), position])[self.observed_indices]
        return self.make_state(data, vector, {"goal": goal, **info})

    def control(self, state: State, action: jax.Array) -> tuple[PhysicsState, jax.Array]:
        fastest = jnp.abs(state.data.qvel[:WRIST]).max()
        pulled = leashed_target(_target(state, action), state.obs[:3], fastest, JOINT_SPEED, LEASH)
        return state.data.replace(mocap_pos=pulled[None]), jnp.stack([action[3], -action[3]])

    def observe(self, state: State, action: jax.Array, data: PhysicsState, sensors: jax.Array) -> NextState:
        data = data.replace(mocap_pos=_target(state, action)[None])
        hand, right, left, object_position = jnp.split(sensors, 4)
        grip = jnp.clip(jnp.linalg.norm(right - left) / OPENING, 0.0, 1.0)
        vector = jnp.concatenate([hand, grip[None], object_position])[self.observed_indices]
        return data, vector, {}

    def _observed_demos(self, demos: Demos) -> Demos:
        """Return `demos` with the numbers that this variant observes; those recorded with it stay as they are."""
        parts = {name: getattr(demos, name) for name in ("states", "goals", "next_states")}
        released = {name: part for name, part in parts.items() if part.shape[1] == RELEASED_SIZE}
        return demos._replace(**{name: part[:, self.observed_indices] for name, part in released.items()})

    def _demo_starts(self, seed: int) -> Iterator[DemoStart]:
        """Yield `demo_count` starts; backward demonstrations cycle through the initial states as goals."""
        for number in range(self.demo_count):
            key = jax.random.fold_in(jax.random.key(seed), number)
            goal = self.initial_states[number % len(self.initial_states)]
            yield DemoStart(forward=self.reset(key), backward=self._backward_demo_start(key), backward_goal=goal)

    def _backward_demo_start(self, key: jax.Array) -> State | None:
        """Return the start of a backward demonstration; None starts it at the end of the forward one."""

    def fault(self, state: State) -> jax.Array:
        object_position, hand = self.object_in(state.obs), state.obs[:3]
        inside = ((object_position >= self.object_low) & (object_position <= self.object_high)).all()
        inside &= ((hand >= HAND_LOW - 0.2) & (hand <= HAND_HIGH + 0.2)).all()
        return super().fault(state) | ~inside

    def object_position(self, state: State) -> jax.Array:
        """Return the observed position [3] of the object in `state`, metres."""
        return self.object_in(state.obs)

    def object_in(self, obs: jax.Array) -> jax.Array:
        """Return the observed position [..., 3] of the object in `obs [..., o]`, metres."""
        return obs[..., self.state_size - 3 : self.state_size]

    def to_goal(self, obs: jax.Array) -> jax.Array:
        """Return the object's distance [...] to its goal in `obs [..., o]`, in metres."""
        return jnp.linalg.norm(self.object_in(obs) - obs[..., -3:], axis=-1)

    def success(self, obs: jax.Array) -> jax.Array:
        return self.to_goal(obs) <= self.radius[self.variant]


def _target(state: State, action: jax.Array) -> jax.Array:
    """Return the position [3] to which `action` moves the hand's target."""
    return jnp.clip(state.data.mocap_pos[0] + REACH * action[:3], HAND_LOW, HAND_HIGH)
