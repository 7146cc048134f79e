"""Sawyer peg: pick a peg up and push it into a hole in the side of a block."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.envs.demonstrations import TaskDemos
from earl_jax.envs.features import ContinuingDefaults, Map, Starts
from earl_jax.envs.sawyer import experts
from earl_jax.envs.sawyer.base import GRIPPER, OPENING, Pose, Sawyer
from earl_jax.envs.shaping import hamacher, long_tail, prism, tolerance
from earl_jax.envs.state import NextState, State, random_row
from earl_jax.errors import InputError
from earl_jax.physics import EngineCost, PhysicsState

HEAD = np.array([-0.1, 0.0, 0.0], np.float32)
"""Position of the peg's head, the observed object, relative to the peg's middle."""
GRASP = np.array([0.03, 0.0, 0.01], np.float32)
"""Grasp position of the dense reward, relative to the peg's middle."""
LOW = np.array([0.0, 0.5, 0.02], np.float32)
HIGH = np.array([0.2, 0.7, 0.02], np.float32)
SCATTER = 0.02
RADIUS = 0.05
NEAREST, WIDEST = 0.335, 0.68
"""Metres: if the middle of the peg has a smaller y or a larger |x|, the hand cannot touch it or can only push it
further away (docs/formalism.md). A hand that overshoots reaches x = 0.545, and therefore a peg of half length 0.12 at
0.68."""
INSERTED = np.array([-0.27, 0.6, 0.13], np.float32)
HEADS = np.array(
    [
        [0.00313463, 0.68326396], [-0.04035005, 0.67949003], [0.02531051, 0.6074387], [0.05957219, 0.6271171],
        [-0.07566337, 0.62575287], [-0.01177235, 0.55206996], [0.02779735, 0.54707706], [0.01835314, 0.5329686],
        [0.02690855, 0.6263067], [0.01766127, 0.59630984], [0.0560186, 0.6634998], [-0.03950658, 0.6323736],
        [-0.03216827, 0.5247563], [0.01265727, 0.69466716], [0.05076993, 0.6025737],
    ],
    np.float32,
)  # fmt: skip
"""x, y of the peg's head in the 15 published initial states."""
FAR_HEADS = np.array(
    [
        [-0.3, 0.8], [-0.4, 0.8], [-0.3, 0.9], [-0.4, 0.9], [-0.2, 0.8], [-0.2, 0.75], [-0.2, 0.9], [-0.1, 0.77],
        [0.0, 0.9], [0.1, 0.8], [0.15, 0.75], [-0.3, 0.4], [-0.4, 0.4], [-0.3, 0.45], [-0.4, 0.45], [-0.2, 0.4],
        [-0.2, 0.45], [-0.2, 0.38], [-0.1, 0.42], [0.0, 0.45], [0.1, 0.36], [0.15, 0.44],
    ],
    np.float32,
)  # fmt: skip
"""x, y of the peg's head in the 22 starts of `wide`."""
BLOCK = np.array([-0.3, 0.6, 0.0], np.float32)
"""Position [m] of the block, which is 0.2 m high, deep and wide, and turned by 90 degrees to the left."""
_LIPS = np.array([[[0.1, -0.11, 0.16], [-0.1, -0.17, 0.19]], [[0.1, -0.11, 0.01], [-0.1, -0.15, 0.096]]], np.float32)
LIPS = BLOCK + np.stack([-_LIPS[..., 1], _LIPS[..., 0], _LIPS[..., 2]], axis=-1)
"""Two boxes in front of the block, above and below the hole: corners of dense reward 0 and 1, `_LIPS` in its frame."""
HOME = Pose(
    target=(0.0, 0.6, 0.2),
    qpos=(
        1.88261579, -0.593460004, -0.959474307, 1.64832854, 0.923299052, 1.02688963, 2.32340571, -1.71909125e-4, 1.71744846e-4,
    ),
    qvel=(
        0.329594884, 0.562470675, -0.620149629, 0.194811339, 0.938798804, 0.209966195, 2.09523271, 1.02772556e-6, 1.02595601e-6,
    ),
    warmstart=(
        0.0914292181, 0.555950558, 0.68652535, -4.51333286, -5.15045738, 7.51743568, -218.555092, 1.00079362e-4, 9.84788047e-5,
    ),
    hand=(0.00615235, 0.6001898, 0.19430117),
    grip=1.0,
)  # fmt: skip

START_TIPS = np.array([0.00599209, 0.60039713, 0.14930194], np.float32)
"""The point between the finger tips in that pose."""


@dataclasses.dataclass(frozen=True)
class SawyerPeg(Sawyer):
    """A robot arm inserts a peg into a box.

    The peg starts anywhere in 20 by 20 cm. Success: the head is within 5 cm of the end of the hole. `listed=True`
    starts at one of the 15 published initial states. `wide=True` starts half of the time within 2 cm of one of 22
    positions all over the table, like the released option `wide_init`.
    """

    train_horizon: int = 100_000
    listed: bool = False
    wide: bool = False

    name: ClassVar[str] = "sawyer_peg"
    engine_cost: ClassVar[EngineCost | None] = EngineCost(host=0.10, device=109.0, warp=5.6)
    continuing: ClassVar[ContinuingDefaults] = ContinuingDefaults(400, train_horizon=50_000)
    demo_count: ClassVar[int] = 10
    pose: ClassVar[Pose] = HOME
    radius: ClassVar[dict[str, float]] = {"released": RADIUS, "paper": RADIUS}
    released_goals: ClassVar[np.ndarray] = np.concatenate([np.array([0.0, 0.6, 0.2, 1.0], np.float32), INSERTED])[None]
    released_starts: ClassVar[np.ndarray] = np.array(
        [[*HOME.hand, HOME.grip, *head, LOW[2]] for head in HEADS], np.float32
    )
    object_low: ClassVar[np.ndarray] = np.array([-0.8, 0.2, -0.02], np.float32)
    object_high: ClassVar[np.ndarray] = np.array([0.6, 1.0, 0.7], np.float32)

    def __post_init__(self):
        super().__post_init__()
        if self.listed + self.wide + self.reset_at_goal > 1:
            raise InputError("listed, wide and reset_at_goal are different starts: choose one of them")

    def reset(self, key: jax.Array) -> State:
        start_key, goal_key = jax.random.split(key)
        return self._start_with_peg(self._peg_start(start_key), random_row(goal_key, self.goal_states))

    def _listed_start(self, key: jax.Array, number: jax.Array) -> State:
        """Return start `number []` of the published list."""
        return self._start_with_peg(_lying_peg(jnp.asarray(HEADS)[number]), jnp.asarray(self.goal_states)[0])

    @property
    def starts(self) -> Starts:
        """The wide starts, as with `wide=True`: half of them are all over the table, where no demonstration begins."""
        wide = self._wide_start if self.sparse and not self.reset_at_goal else None
        return Starts(wide=wide, numbered=self._listed_start, count=len(HEADS)) if self.listed else Starts(wide=wide)

    def _wide_start(self, key: jax.Array) -> State:
        return dataclasses.replace(self, listed=False, wide=True).reset(key)

    def _start_with_peg(self, peg: jax.Array, goal: jax.Array) -> State:
        """Return a start state with the middle of the peg at `peg [3]`; its reward assumes no effort."""
        grasp = jnp.zeros(())
        if not self.sparse:
            grasp = _caging(_tips_about(jnp.asarray(START_TIPS), HOME.grip), peg + HEAD, peg, grasp)
        return self.start_at(peg, peg + HEAD, goal, start=peg, grasp=grasp)

    def joints_at(self, position: jax.Array) -> jax.Array:
        """Return the peg's middle [3] with its head at `position [3]`."""
        return position - HEAD

    @property
    def demonstrations(self) -> TaskDemos:
        """The demonstrations; `variant="paper"` has no script, because a script needs the gripper's opening."""
        demos = super().demonstrations
        return demos if self.variant == "released" else dataclasses.replace(demos, expert=None, script=None)

    def _demonstrated_state(self, vector: jax.Array, goal: jax.Array) -> State:
        return self._start_with_peg(self.joints_at(vector[-3:]), goal)

    def _backward_demo_start(self, key: jax.Array) -> State:
        """Return the start of a backward demonstration: peg inserted, arm in its reset pose, as published."""
        return dataclasses.replace(self, listed=False, wide=False, reset_at_goal=True).reset(key)

    def _peg_start(self, key: jax.Array) -> jax.Array:
        """Return a random start [3] of the middle of the peg."""
        head_key, uniform_key, scatter_key, wide_key = jax.random.split(key, 4)
        scatter = jax.random.uniform(scatter_key, (3,), minval=-SCATTER, maxval=SCATTER)
        uniform = jax.random.uniform(uniform_key, (3,), minval=LOW, maxval=HIGH)
        if self.reset_at_goal:
            return jnp.asarray(INSERTED - HEAD) + scatter
        if self.listed:
            return _lying_peg(random_row(head_key, HEADS))
        if self.wide:
            far = _lying_peg(random_row(head_key, FAR_HEADS)) + scatter
            return jnp.where(jax.random.bernoulli(wide_key), uniform, far)
        return uniform

    def observe(self, state: State, action: jax.Array, data: PhysicsState, sensors: jax.Array) -> NextState:
        data, vector, _ = super().observe(state, action, data, sensors)
        if self.sparse:
            return data, vector, {}
        _, right, left, head = jnp.split(sensors, 4)
        return data, vector, {"grasp": _caging(jnp.stack([right, left]), head, state.info["start"], action[GRIPPER])}

    def irreversible(self, state: State) -> jax.Array:
        """Return whether the peg is off the table (a `fault`: its middle is past an edge) or out of reach."""
        middle = self.object_in(state.obs) - HEAD
        return super().irreversible(state) | (middle[1] < NEAREST) | (jnp.abs(middle[0]) > WIDEST)

    @property
    def map(self) -> Map:
        """The positions of the peg's head, with those at a start and at the goals."""
        return Map(
            position=lambda obs: self.object_in(obs)[..., :2],
            bounds=np.stack([self.object_low[:2], self.object_high[:2]]),
            starts=self._start_heads(),
            goals=self.goal_states[:, -3:-1],
        )

    def _start_heads(self) -> np.ndarray:
        """Return x, y [K, 2] of the head at starts: the listed ones, or a 2 cm grid over the square of starts."""
        if self.reset_at_goal:
            return INSERTED[None, :2]
        if self.listed:
            return HEADS
        sides = (np.linspace(low, high, 11) for low, high in zip(LOW[:2], HIGH[:2], strict=True))
        square = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2) + HEAD[:2]
        return np.concatenate([square, FAR_HEADS]) if self.wide else square

    def reward(self, obs: jax.Array) -> jax.Array:
        """Return the reward [...] of arriving in `obs [..., o]`.

        The dense reward also depends on the action, both finger tips and the peg's start. Here it assumes no effort,
        tips symmetric about the hand, and the nominal start. `step` and `goal_reward` use the actual values.
        """
        if self.sparse:
            return self.success(obs).astype(jnp.float32)
        return jnp.vectorize(self._dense_from_obs, signature="(o)->()")(obs)

    def _dense_from_obs(self, obs: jax.Array) -> jax.Array:
        grip = obs[GRIPPER] if self.variant == "released" else 1.0
        start = jnp.asarray((LOW + HIGH) / 2)
        tips = _tips_about(obs[:3] - jnp.array([0.0, 0.0, 0.045]), grip)
        return self._dense(obs, start, _caging(tips, self.object_in(obs), start, jnp.zeros(())))

    def goal_reward(self, state: State, goal: jax.Array) -> jax.Array:
        if self.sparse:
            return super().goal_reward(state, goal)
        return self._dense(self.with_goal(state, goal).obs, state.info["start"], state.info["grasp"])

    def _dense(self, obs: jax.Array, start: jax.Array, grasp: jax.Array) -> jax.Array:
        """Return Meta-World's peg-insertion reward [] as released with EARL, for one `obs [o]`."""
        hand, head = obs[:3], self.object_in(obs)
        goal, scale = obs[-3:], jnp.array([1.0, 2.0, 2.0])
        grasp_position = head - HEAD + GRASP
        left = jnp.linalg.norm((head - goal) * scale)
        placed = tolerance(left, 0.0, RADIUS, jnp.linalg.norm((start + HEAD - goal) * scale), long_tail)
        bump = hamacher(*[prism(head, *corners) for corners in LIPS])
        placed = hamacher(placed, bump)
        grip = obs[GRIPPER] > 0 if self.variant == "released" else True
        lifted = (jnp.linalg.norm(grasp_position - hand) < 0.08) & grip & (grasp_position[2] - 0.01 > start[2])
        total = hamacher(jnp.where(lifted, 1.0, grasp), placed) + jnp.where(lifted, 1.0 + 5.0 * placed, 0.0)
        return jnp.where(left <= RADIUS, 10.0, total)

    def _expert(self, obs: jax.Array) -> jax.Array:
        return experts.peg(obs[:3], obs[GRIPPER], obs[4:7], obs[-3:])


def _lying_peg(head: jax.Array) -> jax.Array:
    """Return the middle [3] of a lying peg with its `head [2]`."""
    return jnp.append(head, LOW[2]) - HEAD


def _tips_about(middle: jax.Array, grip: jax.Array | float) -> jax.Array:
    """Return the right and left finger tip [2, 3], symmetric about `middle [3]`, `grip []` of their opening apart."""
    side = jnp.array([0.0, OPENING / 2, 0.0]) * grip
    return jnp.stack([middle - side, middle + side])


def _caging(tips: jax.Array, head: jax.Array, start: jax.Array, effort: jax.Array) -> jax.Array:
    """Return the reward for enclosing the peg with the fingers, in [0, 1].

    `tips [2, 3]` are the right and left finger tip, `head [3]` is the peg's head, `start [3]` the start of the peg's
    middle, and `effort []` the gripper's action. Source: Meta-World, `_gripper_caging_reward`, high density.
    """
    reach, radius, thin, pad = 0.03, 0.0075, 0.005, jnp.array([0.003, -0.003])
    grasp_position, middle = head - HEAD + GRASP, tips.mean(axis=0)
    sides = tips[:, 1] + pad
    margin = jnp.abs(jnp.abs(sides - start[1]) - reach)
    right, left = tolerance(jnp.abs(sides - grasp_position[1]), radius, reach, margin, long_tail)
    level = np.array([0, 2])
    across = jnp.linalg.norm(start[level] - START_TIPS[level]) - thin
    level_with = tolerance(jnp.linalg.norm((middle - grasp_position)[level]), 0.0, thin, across, long_tail)
    caging = hamacher(hamacher(right, left), level_with)
    gripping = jnp.where(caging > 0.97, jnp.clip(effort, 0.0, 1.0), 0.0)
    return (hamacher(caging, gripping) + caging) / 2
