"""Franka kitchen: close the open appliances; a reset-free agent must open them again itself.

Source: EARL's `envs/kitchen.py` on Adept's Franka kitchen as released with relay policy learning. The physics are our
own MJCF (assets/mjcf/franka_kitchen.xml); docs/tasks.md lists every difference. The paper's text names other
appliances and the opposite direction: `variant="paper"`.
"""

import dataclasses
import itertools
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax import physics
from earl_jax.envs.features import ContinuingDefaults, Starts
from earl_jax.envs.kitchen import reward as rewards
from earl_jax.envs.mujoco_env import MujocoEnv, leashed_target
from earl_jax.envs.state import NextState, State, stored_key
from earl_jax.physics import EngineCost, PhysicsState

REACH = 0.02
"""Metres that the mocap target moves for an action of 1: the released scale of 2 times 0.01."""
FINGER_REACH = 0.16
"""Radians that an action of 1 adds to a finger's target: the released scale of 2 times a step of 0.08 s."""
MOCAP_LOW = np.array([-0.7, -0.1, 1.8], np.float32)
MOCAP_HIGH = np.array([0.4, 0.5, 2.6], np.float32)
HELD_UPRIGHT = np.array([0.65359542, -0.65307515, -0.27036028, -0.27057566], np.float32)
RADIUS = 0.3
NOISE = np.array([*[0.01] * 9, 0.0005, 0.0005, *[5e-5] * 6, *[5e-4] * 3, *[0.01] * 3], np.float32)
"""Half-width of the uniform noise on each number of a state, robot first."""
CLOSED = np.array(
    [
        -4.1336253e-01, -1.6970085e00, 1.4286385e00, -2.5005307e00, 6.2198675e-01, 1.2632011e00, 8.8903642e-01,
        4.3514766e-02, 7.9217982e-03, -5.1586074e-04, 4.8548312e-04, -5.4527864e-06, 6.3510129e-06, 6.0837720e-05,
        -3.3861103e-05, 6.6394619e-05, -1.9801613e-05, -1.2477605e-04, 3.8065159e-04, -1.5148541e-04, -9.2229841e-04,
        7.2293887e-03, 6.9650509e-03,
    ],
    np.float32,
)  # fmt: skip
"""The goal: a noisy observation, as published."""
OPEN = {
    "micro": {22: -0.7}, "hinge": {20: 0.0, 21: 1.45}, "slide": {19: 0.37}, "light": {17: -0.69, 18: -0.05},
    "bottom_burner": {11: -0.88, 12: -0.01}, "top_burner": {15: -0.92, 16: -0.01},
}  # fmt: skip
"""For each open appliance: indices into a state and their values. The final release has no burner. The values of the
bottom burner are those of its earlier versions and of D4RL's kitchen (Fu et al. 2020), the top burner's are D4RL's."""
PAIRS = (
    ("micro", "hinge"), ("micro", "slide"), ("micro", "light"), ("light", "slide"), ("light", "hinge"), ("slide", "hinge"),
)  # fmt: skip
TEXT_APPLIANCES = ("micro", "hinge", "slide", "bottom_burner", "top_burner")
TEXT_GOALS = (*itertools.combinations(TEXT_APPLIANCES, 2), ("micro", "hinge", "bottom_burner"))
"""The open appliances in each goal of `variant="paper"`: all pairs, as in the release, of the appliances that the
paper's text names (the appendix's two distinct burners replace the light), and the text's example of opening microwave,
door and burner."""
MIDDLE = (-0.44, 0.1, 2.226)
ARM_QPOS = (
    -0.41348427, -1.71317005, 1.42235766, -2.50195035, 0.646138996, 1.25936986, 0.868014878, 0.0399940302, 9.35269783e-05,
)  # fmt: skip
ARM_QVEL = (
    -0.040299345, -0.0971803787, 0.0193296205, 0.0437037565, 0.213034925, -0.0543447929, -0.140530688, 4.5724077e-05,
    -0.000917957306,
)  # fmt: skip
ARM_WARMSTART = (
    0.0394256909, -0.0113677043, -0.0664968568, -0.0486054008, 0.10585123, -0.0560178579, -0.605053158, -0.000547454585,
    0.00923499635,
)  # fmt: skip
"""Arm and fingers after the released reset, which makes ten steps with zero action at the released time step. The arm
still moves, and the left finger is open, because its target is the previous reading of joint 1."""
SHUT = (
    -0.000292405254, 2.75470406e-08, 2.75470406e-08, 2.75470406e-08, 3.19602862e-07, 0.0, -0.00092229841, 0.0072293887, 0.0,
)  # fmt: skip
"""The objects' joints after those ten steps from the goal; joint limits, friction and weight move them slightly."""
SWITCH, LIT = 4, -0.68964165
"""The index of the switch among these joints, and its angle after those ten steps with the light on."""
JOINT_SPEED = np.array([1.0, 4.0], np.float32)
LEASH = np.array([0.12, 0.06], np.float32)
"""Metres by which the mocap body may lead the hand while the fastest joint turns at `JOINT_SPEED` [rad/s]; linear
between. A difference from the original: with the target half a metre behind furniture or out of the arm's reach, a
joint that comes free reaches 87 rad/s (28 with a limit of 0.2 m) and knocks objects past their limits. If the limit
were short for a slow arm too, a folded arm would get stuck."""
OBJECT_SLACK = 0.3
ARM_SLACK = 20.0
"""Distances (rad, m) beyond their limits from which object and arm joints mean a broken simulation. The arm's limits
are soft, as in the original: after long dragging, the last joint is 10 rad beyond its limit."""


@dataclasses.dataclass(frozen=True)
class FrankaKitchen(MujocoEnv):
    """A robot arm closes two open appliances of four.

    `obs [46]` = robot 9, objects 14, goal 23; `action [9]`, three effective.
    `action[:3]` moves a mocap body, which drags the hand, by up to 2 cm along each axis. As in the released code, the
    fingers' targets are the observed angles of the first two arm joints plus `FINGER_REACH * action[:2]`, which clips
    to closed or open depending on the arm's pose, and the other components are dropped. The metric is the return over
    `eval_horizon` steps. Success is reported as well: the 14 object numbers are within 0.3 of the goal. `noise=False`
    observes exactly. `substeps=40` is the released time step of 2 ms.

    `variant="paper"` uses the appliances, direction and reward of the paper's text: everything is closed at the start,
    and a goal is one of `TEXT_GOALS`. The text names microwave, hinged cabinet, two burners and slide cabinet, and
    gives opening as an example. It does not specify joint values, the other tasks, the start and success; these follow
    the release. The reward is `reward.published`.
    """

    reward_type: str = "dense"
    train_horizon: int = 100_000
    eval_horizon: int = 400
    substeps: int = 12
    variant: Literal["released", "paper"] = "released"
    noise: bool = True

    name: ClassVar[str] = "franka_kitchen"
    engine_cost: ClassVar[EngineCost | None] = EngineCost(host=0.49, device=47.0)
    state_size: ClassVar[int] = 23
    action_size: ClassVar[int] = 9
    continuing: ClassVar[ContinuingDefaults] = ContinuingDefaults(800, train_horizon=50_000)
    control_step: ClassVar[float] = 0.08

    @property
    def goal_states(self) -> np.ndarray:
        return with_open(TEXT_GOALS) if self.variant == "paper" else CLOSED[None].copy()

    @property
    def initial_states(self) -> np.ndarray:
        return CLOSED[None].copy() if self.variant == "paper" else with_open(PAIRS)

    def reset(self, key: jax.Array) -> State:
        pair_key, _ = jax.random.split(key)
        return self._start(key, jax.random.randint(pair_key, (), 0, len(self.initial_states)))

    @property
    def starts(self) -> Starts:
        return Starts(numbered=self._start, count=len(self.initial_states))

    def _start(self, key: jax.Array, number: jax.Array) -> State:
        """Return the start with the appliances as in `initial_states[number]`; `key` draws goal and noise."""
        pair_key, noise_key = jax.random.split(key)
        goal = self.sample_goal(pair_key)  # of the pair and the goal, either variant has only a single choice
        starts = self.initial_states[:, rewards.FIRST[rewards.ROBOT :]]
        untouched = starts == CLOSED[rewards.FIRST[rewards.ROBOT :]]
        opened = np.where(np.arange(len(SHUT)) == SWITCH, np.float32(LIT), starts)
        objects = jnp.asarray(np.where(untouched, np.array(SHUT, np.float32), opened))[number]
        qpos, rest = jnp.append(jnp.array(ARM_QPOS, jnp.float32), objects), jnp.zeros_like(objects)
        data = PhysicsState.at(
            qpos=qpos,
            qvel=jnp.append(jnp.array(ARM_QVEL, jnp.float32), rest),
            mocap_pos=jnp.array([MIDDLE], jnp.float32),
            mocap_quat=jnp.asarray(HELD_UPRIGHT)[None],
            qacc_warmstart=jnp.append(jnp.array(ARM_WARMSTART, jnp.float32), rest),
        )
        vector, changed = self._observe(data, stored_key(noise_key))
        sites = rewards.site_positions(rewards.observed(qpos))
        return self.make_state(data, vector, {"goal": goal, "sites": sites, **changed})

    def _observe(self, data: PhysicsState, noise: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
        """Return the observation [23] of `data`, and the changed fields of `info`: noise key and mocap position."""
        following, drawn = jax.random.split(jax.random.wrap_key_data(noise))
        vector = rewards.observed(data.qpos)
        if self.noise:
            vector = vector + NOISE * jax.random.uniform(drawn, vector.shape, minval=-1.0)
        return vector, {"noise": jax.random.key_data(following), "mocap": data.mocap_pos[0]}

    def control(self, state: State, action: jax.Array) -> tuple[PhysicsState, jax.Array]:
        hand = rewards.dragging_position(rewards.observed(state.data.qpos))
        fastest = jnp.abs(state.data.qvel[:7]).max()
        pulled = leashed_target(_target(state, action), hand, fastest, JOINT_SPEED, LEASH)
        return state.data.replace(mocap_pos=pulled[None]), state.obs[:2] + FINGER_REACH * action[:2]

    def observe(self, state: State, action: jax.Array, data: PhysicsState, sensors: jax.Array) -> NextState:
        data = data.replace(mocap_pos=_target(state, action)[None])
        vector, changed = self._observe(data, state.info["noise"])
        return data, vector, {**changed, "sites": sensors[: 3 * len(rewards.SITES)].reshape(-1, 3)}

    def _at_goal(self, state: State) -> PhysicsState:
        robot, objects = state.data.qpos[: rewards.ROBOT], state.info["goal"][rewards.FIRST[rewards.ROBOT :]]
        return state.data.replace(qpos=jnp.concatenate([robot, objects]))

    def object_position(self, state: State) -> jax.Array:
        """Return the joints [n] of the appliances in `state`, radians and metres."""
        return state.data.qpos[rewards.ROBOT :]

    def success(self, obs: jax.Array) -> jax.Array:
        objects = obs[..., rewards.ROBOT : 23] - obs[..., 23 + rewards.ROBOT :]
        return jnp.linalg.norm(objects, axis=-1) <= RADIUS

    def reward(self, obs: jax.Array) -> jax.Array:
        """Return the reward [...] of arriving in `obs [..., 46]`.

        The released reward also depends on the mocap body and on exact handle positions. Here both are computed from
        the observed arm and objects, so noise shifts them by centimetres. `step` and `goal_reward` use the exact
        positions.
        """
        if self.sparse:
            return self.success(obs).astype(jnp.float32)

        def reward_of(obs):
            if self.variant == "paper":
                return rewards.published(obs)
            return rewards.released(obs, rewards.dragging_position(obs[:23]), rewards.site_positions(obs[:23]))

        return jnp.vectorize(reward_of, signature="(o)->()")(obs)

    def goal_reward(self, state: State, goal: jax.Array) -> jax.Array:
        if self.sparse or self.variant == "paper":
            return super().goal_reward(state, goal)
        return rewards.released(self.with_goal(state, goal).obs, state.info["mocap"], state.info["sites"])

    def fault(self, state: State) -> jax.Array:
        low, high = physics.load_model(self.model).jnt_range.T.astype(np.float32)
        slack = np.where(np.arange(len(low)) < rewards.ROBOT, np.float32(ARM_SLACK), np.float32(OBJECT_SLACK))
        inside = (state.data.qpos > low - slack) & (state.data.qpos < high + slack)
        return super().fault(state) | ~inside.all()


def with_open(groups: tuple[tuple[str, ...], ...]) -> np.ndarray:
    """Return a state for each of n `groups` of appliances, float32 [n, 23], with the group open and the rest closed."""
    states = np.tile(CLOSED, (len(groups), 1))
    for state, group in zip(states, groups, strict=True):
        for appliance in group:
            state[list(OPEN[appliance])] = list(OPEN[appliance].values())
    return states


def _target(state: State, action: jax.Array) -> jax.Array:
    """Return the position [3] to which `action` moves the hand's target."""
    return jnp.clip(state.data.mocap_pos[0] + REACH * action[:3], MOCAP_LOW, MOCAP_HIGH)
