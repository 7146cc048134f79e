"""The one reset-free loop: act, step, store, sample, learn, for every method and all lanes at once.

A lane is a life with its seed. `depart`, `learn` and `arrive` are written for one lane and vmapped; between them the replay is
read and written unbatched, because it is one buffer. The gradient step of a control step samples what was stored before it, so
that a host can simulate while the accelerator learns (the release samples through a prefetched dataset, as late). Resets are a
select, not a branch: a branch under vmap would pay for both sides as well, and a select handles a lane's own resets, scheduled
interventions and later faults by one rule.
"""

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from earl_jax.algos import replay as replay_lib
from earl_jax.algos import sac as sac_lib
from earl_jax.algos.method import TASK, Commands, Goals, Method, goals_of
from earl_jax.algos.replay import Marks, Replay, Rows, Transition
from earl_jax.envs import Env, State
from earl_jax.protocol import Protocol

UNLIKELY = -1.2345e38
"""A number that nothing here ever is, so that a comparison with it orders a program and changes nothing."""


class Tally(struct.PyTreeNode):
    """What a lane has earned and suffered: task reward since the last report and in all, interventions (`faults` among
    them were enforced by a broken simulation), goals reached."""

    window_reward: jax.Array
    total_reward: jax.Array
    interventions: jax.Array
    faults: jax.Array
    reached: jax.Array
    diagnostics: dict[str, jax.Array]


class Lane(struct.PyTreeNode):
    """One life: its key, world, phase, commands, learner and tally."""

    key: jax.Array
    world: State
    phase: jax.Array
    phase_step: jax.Array
    commands: Commands
    agent: sac_lib.Agent
    extra: Any
    tally: Tally


class Lives(struct.PyTreeNode):
    """All lanes (leading axis N), their replay, and the number of steps each has lived."""

    lanes: Lane
    replay: Replay
    step: jax.Array


class Keys(NamedTuple):
    """A lane's randomness of one step, a function of its seed and the step alone."""

    act: jax.Array
    goal: jax.Array
    reset: jax.Array
    sample: jax.Array
    relabel: jax.Array
    update: jax.Array


def keys_of(key: jax.Array, step: jax.Array) -> Keys:
    """Return the randomness of one lane at `step`."""
    parts = jax.random.split(jax.random.fold_in(key, step), len(Keys._fields))
    return Keys(*[parts[number] for number in range(len(Keys._fields))])


@dataclasses.dataclass(frozen=True)
class Loop:
    """The static half of a program: the world, its goals and the protocol it is lived under."""

    env: Env
    protocol: Protocol

    @property
    def goals(self) -> Goals:
        """The goal table that replay's indices point into."""
        return goals_of(self.env)


class Outcome(NamedTuple):
    """How one step of a lane ended, bool scalars: the phase is `over` where the goal was `reached` or time ran out.

    A `fault` is an intervention of that lane alone: the simulation broke, and nothing of the step is kept.
    """

    fault: jax.Array
    reached: jax.Array
    timeout: jax.Array
    over: jax.Array
    intervene: jax.Array
    reset: jax.Array


def outcome_of(loop: Loop, method: Method, lane: Lane, world: State, step: jax.Array) -> Outcome:
    """Return how the step that led `lane` to `world` ended: the one rule of done, for every method."""
    fault = loop.env.fault(world)
    reached = loop.env.sparse & loop.env.success(world.obs) & method.ends_on_success(lane.phase) & ~fault
    intervene = loop.protocol.intervention_due(step + 1) | fault
    expired = (lane.phase_step + 1 >= method.phase_length(loop.env, lane.phase)) | intervene
    over = reached | expired
    return Outcome(fault, reached, expired & ~reached, over, intervene, intervene | (over & method.resets))


@jax.named_scope("act")
def depart(loop: Loop, method: Method, lane: Lane, key: jax.Array, explore: bool) -> tuple[jax.Array, Any]:
    """Return the action [a] of one lane, uniform with `explore`, and the control step that it sets off, in flight."""
    action = _act(loop, method, lane, key, explore)
    return action, loop.env.launch(lane.world, action)


@jax.named_scope("physics")
def arrive(
    loop: Loop, method: Method, lane: Lane, action: jax.Array, flight: Any, keys: Keys, step: jax.Array
) -> tuple:
    """Return the lane after the control step in `flight`, the `Transition` it made and whether replay should list it.

    `step []` counts from 0.
    """
    env, table = loop.env, jnp.asarray(loop.goals.table)
    world = env.land(lane.world, flight)
    end = outcome_of(loop, method, lane, world, step)
    earned = env.goal_reward(world, table[lane.commands.task])
    tally = lane.tally.replace(
        window_reward=lane.tally.window_reward + jnp.where(end.fault, 0.0, earned),
        interventions=lane.tally.interventions + end.reset,
        faults=lane.tally.faults + end.fault,
        reached=lane.tally.reached + (end.reached & (lane.phase == TASK)),
    )
    phase = jnp.where(end.intervene, TASK, jnp.where(end.over, (lane.phase + 1) % method.phases, lane.phase))
    fresh = method.next_goal(keys.goal, loop.goals, phase, lane.commands, lane.extra)
    commands = jax.tree.map(lambda new, old: jnp.where(end.over, new, old), fresh, lane.commands)
    onward = jax.tree.map(lambda new, old: jnp.where(end.reset, new, old), env.reset(keys.reset), world)
    onward = env.with_goal(onward, table[commands.goal])

    marks = Marks(lane.commands.goal, end.reached, end.timeout, end.reset)
    reward = jnp.where(end.fault, 0.0, world.reward)
    transition = Transition(action, onward.obs[: env.state_size], reward, marks)
    bootstrapped = end.timeout & jnp.asarray(method.sac.timeout_bootstrap, bool)
    phase_step = jnp.where(end.over, 0, lane.phase_step + 1)
    lane = lane.replace(world=onward, phase=phase, phase_step=phase_step, commands=commands, tally=tally)
    return lane, transition, ~(end.reset & bootstrapped) & ~end.fault


def _act(loop: Loop, method: Method, lane: Lane, key: jax.Array, explore: bool) -> jax.Array:
    size = loop.env.action_size
    if explore:
        return jax.random.uniform(key, (size,), minval=-1.0, maxval=1.0)
    actor = _take(lane.agent.actor, controller_of(method, lane.phase))
    return sac_lib.act(method.sac, actor, lane.world.obs, key, size)


def controller_of(method: Method, phase: jax.Array) -> jax.Array:
    """Return which controller acts in `phase`: with one controller always 0."""
    return jnp.minimum(phase, method.controllers - 1)


@jax.named_scope("update")
def learn(loop: Loop, method: Method, lane: Lane, keys: Keys, rows: Rows, phase: jax.Array) -> Lane:
    """Return the lane after one SAC step of the controller that acted in `phase`, on sampled transitions `rows [B]`."""
    table = jnp.asarray(loop.goals.table)
    rows = method.relabel(keys.relabel, loop.env, loop.goals, rows)
    goal = table[rows.marks.goal]
    batch = sac_lib.Batch(
        obs=jnp.concatenate([rows.state, goal], axis=-1),
        action=rows.action,
        reward=method.reward(rows, phase, lane.extra),
        terminal=method.terminal(rows),
        next_obs=jnp.concatenate([rows.next_state, goal], axis=-1),
    )
    controller = controller_of(method, phase)
    agent, diagnostics = sac_lib.update(method.sac, _take(lane.agent, controller), batch, keys.update)
    extra = method.learn_extra(lane.extra, rows, phase)
    tally = lane.tally.replace(diagnostics=diagnostics)
    return lane.replace(agent=_put(lane.agent, agent, controller), extra=extra, tally=tally)


def _take(stacked: Any, index: jax.Array) -> Any:
    """Return one controller of a stacked tree; a stack of one needs no gather."""
    return jax.tree.map(lambda leaf: leaf[0] if leaf.shape[0] == 1 else leaf[index], stacked)


def _put(stacked: Any, single: Any, index: jax.Array) -> Any:
    def put(leaf, value):
        return value[None] if leaf.shape[0] == 1 else leaf.at[index].set(value)

    return jax.tree.map(put, stacked, single)


def step_lives(loop: Loop, method: Method, lives: Lives, explore: bool = False) -> Lives:
    """Return all lanes one step later: act, store and, unless exploring, one gradient step a lane on what was stored before.

    `method`'s float leaves have a leading lane axis.
    """
    step, lanes, replay = lives.step, lives.lanes, lives.replay
    controller = controller_of(method, lanes.phase)
    keys = jax.vmap(keys_of, (0, None))(lanes.key, step)
    action, flight = jax.vmap(lambda m, lane, key: depart(loop, m, lane, key, explore))(method, lanes, keys.act)
    if not explore:
        wanted = _once_begun(flight, controller)
        rows = replay_lib.sample(replay, keys.sample, wanted, method.sac.batch_size, jnp.asarray(method.sac.demo_share))
        replay, rows = _once_read(replay, rows)
        lanes = jax.vmap(lambda *each: learn(loop, *each))(method, lanes, keys, rows, lanes.phase)
        flight = _once_learnt(lanes.agent, flight)
    land = jax.vmap(lambda m, lane, one, away, key: arrive(loop, m, lane, one, away, key, step))
    lanes, transition, listed = land(method, lanes, action, flight, keys)
    return Lives(lanes, replay_lib.write(replay, transition, listed, controller), step + 1)


def _once_read(replay: Replay, rows: Rows) -> tuple[Replay, Rows]:
    """Return both unchanged, but where to write known only after `rows` were read: else XLA copies the whole buffer each step."""
    rows = jax.lax.optimization_barrier(rows)
    numbers = [leaf.ravel()[0].astype(jnp.float32) for leaf in jax.tree.leaves(rows)]
    return replay.replace(row=replay.row + (sum(numbers) == UNLIKELY)), rows


def _once_begun(flight: Any, values: jax.Array) -> jax.Array:
    """Return integers `values [N]` unchanged, but known only after the host has begun on `flight`.

    XLA orders by data alone; only the tickets of work on the host are integers, and none is negative.
    """
    tickets = [leaf for leaf in jax.tree.leaves(flight) if jnp.issubdtype(leaf.dtype, jnp.integer)]
    return functools.reduce(lambda held, ticket: jnp.where(ticket[:, 0] >= 0, held, 0), tickets, values)


def _once_learnt(agent: sac_lib.Agent, flight: Any) -> Any:
    """Return `flight` unchanged, but its tickets known only after `agent`: one number of each array, which is never UNLIKELY."""

    def held(leaf):
        if not jnp.issubdtype(leaf.dtype, jnp.integer):
            return leaf
        numbers = jnp.stack([part.reshape(part.shape[0], -1)[:, 0] for part in jax.tree.leaves(agent)])
        return leaf + (numbers.sum(axis=0)[:, None] == UNLIKELY)

    return jax.tree.map(held, flight)


def run(loop: Loop, method: Method, lives: Lives, steps: int, explore: bool = False) -> Lives:
    """Return all lanes `steps` later in one scan; k calls of whole blocks equal one call of k times the steps, bit for bit.

    A method's `refresh` runs at the start of every block of `refresh_every` steps counted from the call, or of the
    largest common divisor with `steps` where that is smaller.
    """
    block = math.gcd(method.refresh_every, steps)

    def body(carry, _):
        return step_lives(loop, method, carry, explore), None

    def refreshed_block(carry, _):
        return jax.lax.scan(body, refresh(loop, method, carry), length=block)[0], None

    if method.refresh_every == 0 or explore:
        return jax.lax.scan(body, lives, length=steps)[0]
    return jax.lax.scan(refreshed_block, lives, length=steps // block)[0]


def refresh(loop: Loop, method: Method, lives: Lives) -> Lives:
    """Return the lanes with what their method derives from the agent brought up to date."""

    def one(m, lane):
        key = jax.random.fold_in(jax.random.fold_in(lane.key, lives.step), 1)
        return m.refresh(key, loop.env, loop.goals, lane.agent, lane.extra)

    return lives.replace(lanes=lives.lanes.replace(extra=jax.vmap(one)(method, lives.lanes)))
