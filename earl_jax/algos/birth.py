"""How lives begin: fresh agents, s0 ~ rho, and demonstrations as the first rows of the replay."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos import replay as replay_lib
from earl_jax.algos import sac as sac_lib
from earl_jax.algos.life import BINS, Lane, Lives, Loop, Tally
from earl_jax.algos.method import TASK, Commands, Method, trajectories
from earl_jax.algos.replay import Marks, Replay
from earl_jax.protocol import Rules


class DemoRows(NamedTuple):
    """Demonstrations laid out as replay rows: R states, and T transitions with row, controller and copies of each."""

    states: np.ndarray
    rows: np.ndarray
    actions: np.ndarray
    goals: np.ndarray
    controllers: np.ndarray
    copies: np.ndarray

    def listed(self, controller: int) -> np.ndarray:
        """Return the rows that `controller` samples from, each as often as it is to be listed."""
        mine = self.controllers == controller
        return np.repeat(self.rows[mine], self.copies[mine])


def demo_rows(loop: Loop, method: Method) -> DemoRows | None:
    """Return the demonstrations that `method` puts in its replay, or None where the task has none.

    Raises:
        ValueError: the method cannot work without demonstrations and the task has none, or none whose states could be goals.
    """
    if not loop.env.has_demos:
        if method.needs_demos:
            raise ValueError(f"{method.name} needs demonstrations, and {loop.env.name} has none")
        return None
    if method.needs_demos and loop.env.state_size != loop.env.goal_size:
        raise ValueError(
            f"{method.name} needs demonstrated states that can be goals: here a state of {loop.env.name} is "
            f"{loop.env.state_size} numbers, a goal {loop.env.goal_size}"
        )
    parts, first = [], 0
    for number, direction in enumerate(method.demo_directions):
        demos = loop.env.demos(direction)
        states, last = trajectories(demos)
        rows = np.flatnonzero(np.arange(len(states)) < last)
        controllers = np.full(len(rows), min(number, method.controllers - 1))
        goals, copies = _goal_indices(loop, demos.goals), method.demo_copies(last[rows] - rows)
        parts.append(DemoRows(states, first + rows, demos.actions, goals, controllers, copies))
        first += len(states)
    return DemoRows(*[np.concatenate(field) for field in zip(*parts, strict=True)])


def _goal_indices(loop: Loop, goals: np.ndarray) -> np.ndarray:
    """Return the table entries [T] of demonstrated goals [T, g], which are task goals or initial states."""
    known = loop.goals.table[: loop.goals.tasks + loop.goals.initials]
    distance = np.abs(goals[:, None] - known[None]).max(axis=-1)
    if distance.min(axis=1).max() > 1e-6:
        raise ValueError(
            f"a demonstration of {loop.env.name} has a goal that is neither a task goal nor an initial state"
        )
    return distance.argmin(axis=1)


def capacity_for(loop: Loop, method: Method, steps: int) -> int:
    """Return the replay rows that `steps` and the demonstrations take: nothing is ever evicted."""
    demos = demo_rows(loop, method)
    return steps + (0 if demos is None else max(len(demos.states), int(demos.copies.sum())))


def _first_rows(loop: Loop, method: Method, lanes: int, capacity: int) -> Replay:
    env, demos = loop.env, demo_rows(loop, method)
    replay = replay_lib.create(capacity, lanes, env.state_size, env.action_size, env.sparse)
    if demos is None:
        return replay
    obs = jnp.concatenate([demos.states[demos.rows + 1], loop.goals.table[demos.goals]], axis=-1)
    reached = env.success(obs) & env.sparse
    no = jnp.zeros_like(reached)
    words = replay_lib.pack(Marks(jnp.asarray(demos.goals), reached, no, no, no))
    mine, other = demos.listed(0), demos.listed(1)
    index = replay.index.at[: len(mine)].set(mine[:, None])
    index = index.at[capacity - len(other) :].set(other[::-1, None])
    return replay.replace(
        state=replay.state.at[: len(demos.states)].set(demos.states[:, None]),
        action=replay.action.at[demos.rows].set(demos.actions[:, None]),
        marks=replay.marks.at[demos.rows].set(words[:, None]),
        reward=replay.reward if env.sparse else replay.reward.at[demos.rows].set(env.reward(obs)[:, None]),
        index=index,
        counts=jnp.broadcast_to(jnp.array([len(mine), len(other)], jnp.int32), (lanes, 2)),
        demos=jnp.array([len(mine), len(other)], jnp.int32),
        row=jnp.asarray(len(demos.states), jnp.int32),
    )


def _newborn(loop: Loop, method: Method, key: jax.Array, rules: Rules) -> Lane:
    env, goals = loop.env, loop.goals
    agent_key, extra_key, world_key, goal_key, life_key = jax.random.split(key, 5)

    def agent(part):
        return sac_lib.init(part, method.sac, env.obs_size, env.action_size, method.critics)

    extra = method.init_extra(extra_key, env, goals)
    queued = goals.draw_task(jax.random.fold_in(goal_key, 1))
    phase = jnp.asarray(TASK, jnp.int32)
    commands = method.next_goal(goal_key, goals, phase, Commands(queued, queued), extra)
    world = env.with_goal(env.reset(world_key), jnp.asarray(goals.table)[commands.goal])
    zero, none = jnp.zeros(()), jnp.zeros((), jnp.int32)
    tally = Tally(zero, zero, none, none, none, dict.fromkeys(sac_lib.DIAGNOSTICS, zero))
    agents = jax.vmap(agent)(jax.random.split(agent_key, method.controllers))
    visits = None if env.area is None else jnp.zeros((BINS, BINS), jnp.int32)
    return Lane(life_key, world, phase, none, commands, agents, extra, tally, rules, visits)


def begin(loop: Loop, method: Method, keys: jax.Array, capacity: int, rules: Rules | None = None) -> Lives:
    """Return N lives at step 0 from PRNG keys [N]; leaves of `method` and `rules` have a leading lane axis.

    Without `rules` those of the loop's protocol hold for every lane.
    """
    if rules is None:
        rules = jax.tree.map(lambda rule: jnp.full(keys.shape[0], rule), loop.protocol.rules)
    lanes = jax.vmap(lambda *each: _newborn(loop, *each))(method, keys, rules)
    replay = _first_rows(loop, method, keys.shape[0], capacity)
    start = lanes.world.obs[None, :, : loop.env.state_size]
    state = jax.lax.dynamic_update_slice(replay.state, start, (replay.row, 0, 0))
    return Lives(lanes, replay.replace(state=state), jnp.zeros((), jnp.int32))
