"""Minitaur pen: a quadruped with eight motors walks to a position in a pen; a fall does not end an episode.

Source: the released EARL environment on PyBullet's Minitaur. The physics are our own MJCF (assets/mjcf), tested against
poses and trots that were recorded there; docs/tasks.md lists every difference.
"""

import dataclasses
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.features import ContinuingDefaults, Map
from earl_jax.envs.minitaur import body
from earl_jax.envs.minitaur.motors import DIRECTION, MOTORS, POSITIONS, SPEEDS, MinitaurMotors
from earl_jax.envs.mujoco_env import MujocoEnv
from earl_jax.envs.state import NextState, State
from earl_jax.physics import EngineCost, PhysicsState, Simulator

RADIUS = 0.1
GOALS = np.array([(x, y) for x in (-0.4, -0.2, 0.2, 0.4) for y in (0.0, 0.2, 0.4)], np.float32)
VOLTS, NOMINAL_VOLTS = (14.8, 16.8), 16.0
VISCOSITIES, NOMINAL_VISCOSITY = (0.0, 0.01), 0.0
"""Range of the viscosity, V s/rad, which adds to the back-EMF."""
EFFORT = {"released": -0.005 * 0.002, "paper": 0.02}
"""Weight of the motors' power in each variant's reward; the released reward is -0.005 times the work of one 2 ms
substep."""
FAR = {"closed": 1.75, "floating": 100.0}
"""Distance in metres from the middle beyond which the simulation broke, for each kind of wall."""
HIGH = 2.0
ON_ITS_BACK = -0.5
"""Cosine between the body's up axis and the vertical below which no robot ever recovered: docs/formalism.md."""
WALL = 1.5
"""Metres from the middle to the walls."""

STANDING = (
    (
        -0.000707922498, -6.86512891e-05, 0.158150353, 0.999999891, 7.51515086e-05, -0.000452908581, -8.42610288e-05,
        -1.49839542, 2.25669983, -1.49242905, 2.25702727, -1.49508459, 2.26021022, -1.48833516, 2.26050417,
        1.491641, -2.25742916, 1.49826436, -2.25714554, 1.48797454, -2.2607659, 1.49490019, -2.26046532,
    ),
    (
        -0.00277706545, -0.000528385907, 0.112516292, 0.00762287688, -0.00051234212, 0.00493207018,
        -1.06208824, -0.990449226, -1.03372734, -0.993214551, -1.06381984, -0.990063542, -1.03670776, -0.992474159,
        1.0270888, 0.980081882, 1.04238475, 0.977797952, 1.02879865, 0.979049084, 1.04371212, 0.976684695,
    ),
    (
        0.141939959, 0.0198406762, -4.17532743, -0.293252718, 0.127499409, -0.117010536,
        39.3936285, 35.8371292, 38.3028803, 36.1176326, 39.330873, 35.6651026, 38.1966527, 35.9065803,
        -38.2282875, -35.898999, -39.0575368, -35.6630831, -37.7938118, -35.3936648, -38.6194129, -35.156471,
    ),
)  # fmt: skip
"""qpos, qvel and warm start of the nominal robot after the released reset: motors held at 90 degrees for 0.2 s."""
REPORTED = (0.424335717, 0.477845813, 0.451270707, 0.511036733, 0.485318034, 0.428432067, 0.51529674, 0.455987717)
"""The torques that the motors report after that reset."""


@dataclasses.dataclass(frozen=True)
class MinitaurPen(MujocoEnv):
    """A quadruped walks to a position in a pen.

    `obs [32]` = motor angles 8, speeds 8, torques 8, quaternion 4, position 2, goal 2. There are 12 goals. The
    quaternion is xyzw. `action [8]` is in leg space: four swings, then four extensions; legs: front left, back left,
    front right, back right. `randomize` draws masses (20 %), battery, viscosity and the feet's friction at every reset,
    as released. `overheat` shuts down a motor that was above 2.45 N m for a second, until the next reset.
    `walls="floating"` is the released pen, out of which a crouching robot can walk. `variant="paper"` uses
    the reward of the paper's text. A fall does not end an episode, as released.
    """

    reward_type: str = "dense"
    train_horizon: int = 100_000
    eval_horizon: int = 1000
    substeps: int = 5
    randomize: bool = True
    overheat: bool = True
    walls: Literal["closed", "floating"] = "closed"
    variant: Literal["released", "paper"] = "released"
    """The released reward, or the reward of the paper's text."""

    name: ClassVar[str] = "minitaur_pen"
    engine_cost: ClassVar[EngineCost | None] = EngineCost(host=0.31, device=9.1)
    state_size: ClassVar[int] = 30
    action_size: ClassVar[int] = MOTORS
    goal_states: ClassVar[np.ndarray] = GOALS
    initial_states: ClassVar[np.ndarray] = np.zeros((1, 2), np.float32)
    continuing: ClassVar[ContinuingDefaults] = ContinuingDefaults(2000)
    control_step: ClassVar[float] = 0.01

    @property
    def model(self) -> str:
        return self.name if self.walls == "closed" else f"{self.name}_floating"

    @property
    def simulator(self) -> Simulator:
        """The simulator with the robot's motors and, with `randomize`, its own masses and friction in each lane."""
        simulator = super().simulator
        motors = MinitaurMotors(overheat=self.overheat, timestep=simulator.timestep)
        return dataclasses.replace(simulator, actuator=motors, varied=body.VARIED if self.randomize else ())

    @property
    def reward_scale(self) -> float:
        """The learner's default factor on the reward: 0.1 if it is dense, as released for such tasks."""
        return 10.0 if self.sparse else 0.1

    def reset(self, key: jax.Array) -> State:
        goal_key, body_key, battery_key = jax.random.split(key, 3)
        qpos, qvel, warmstart = (jnp.asarray(part, jnp.float32) for part in STANDING)
        battery, constants = jnp.array([NOMINAL_VOLTS, NOMINAL_VISCOSITY]), jnp.zeros((0,))
        if self.randomize:
            low, high = jnp.array([VOLTS, VISCOSITIES]).T
            battery = jax.random.uniform(battery_key, (2,), minval=low, maxval=high)
            constants = body.draw(body_key, self.model)
        memory = jnp.concatenate([jnp.zeros(MOTORS), jnp.asarray(REPORTED), battery])
        data = PhysicsState.at(qpos, qvel, qacc_warmstart=warmstart, memory=memory, constants=constants)
        return self.make_state(data, observed(data), {"goal": self.sample_goal(goal_key)})

    def control(self, state: State, action: jax.Array) -> tuple[PhysicsState, jax.Array]:
        return state.data, legs_to_motors(action)

    def observe(self, state: State, action: jax.Array, data: PhysicsState, sensors: jax.Array) -> NextState:
        return data, observed(data), {}

    def _at_goal(self, state: State) -> PhysicsState:
        upright = jnp.asarray(STANDING[0][2:], jnp.float32)
        return state.data.replace(qpos=jnp.concatenate([state.info["goal"], upright]))

    def success(self, obs: jax.Array) -> jax.Array:
        return jnp.linalg.norm(obs[..., 28:30] - obs[..., 30:], axis=-1) < RADIUS

    def irreversible(self, state: State) -> jax.Array:
        """Return whether the robot is on its back (its up axis more than 120 degrees from the vertical) or at fault.

        A robot at rest stands (cosine 1), lies on a side (about 0.1) or lies on its back (below -0.9).
        """
        x, y = state.obs[24:26]
        return super().irreversible(state) | (1.0 - 2.0 * (x**2 + y**2) < ON_ITS_BACK)

    @property
    def map(self) -> Map:
        """The positions of the robot's base; with floating walls it may leave the bounds."""
        bounds = np.array([[-WALL, -WALL], [WALL, WALL]], np.float32)
        return Map(position=lambda obs: obs[..., 28:30], bounds=bounds, starts=self.initial_states, goals=GOALS)

    def reward(self, obs: jax.Array) -> jax.Array:
        """Return the reward [...] of arriving in `obs [..., 32]`.

        The released reward is minus twice the L1 distance to the goal, minus a small multiple of the motors' power. In
        the paper's text the distance is L2, and the power is rewarded, with a weight two thousand times as large.
        """
        if self.sparse:
            return self.success(obs).astype(jnp.float32)
        power = jnp.abs((obs[..., 8:16] * obs[..., 16:24]).sum(axis=-1))
        order = 1 if self.variant == "released" else 2
        distance = jnp.linalg.norm(obs[..., 28:30] - obs[..., 30:], ord=order, axis=-1)
        return -2.0 * distance + EFFORT[self.variant] * power

    def fault(self, state: State) -> jax.Array:
        x, y, z = state.data.qpos[:3]
        far = FAR[self.walls]
        inside = (jnp.abs(x) < far) & (jnp.abs(y) < far) & (z > -0.1) & (z < HIGH)
        return super().fault(state) | ~inside


def legs_to_motors(action: jax.Array) -> jax.Array:
    """Return the motors' angles [..., 8] for an `action [..., 8]` in leg space: 4 swings, 4 extensions, in [-1, 1].

    Source: the released leg model. An extension of 1 folds a leg, -1 stretches it.
    """
    swing, extension = jnp.repeat(action[..., :4], 2, axis=-1), jnp.repeat(action[..., 4:], 2, axis=-1)
    sign = np.array([1, -1, 1, -1, -1, 1, -1, 1], np.float32)
    return np.pi - np.pi / 4 * (extension + 1.5) + sign * np.pi / 4 * swing


def observed(data: PhysicsState) -> jax.Array:
    """Return the state [30] of a robot in `data`: angles and speeds with the motors' sign, orientation as xyzw."""
    angles, speeds = data.qpos[POSITIONS] * DIRECTION, data.qvel[SPEEDS] * DIRECTION
    reported, orientation = data.memory[MOTORS : 2 * MOTORS], jnp.roll(data.qpos[3:7], -1)
    return jnp.concatenate([angles, speeds, reported, orientation, data.qpos[:2]])
