"""The one reset-free loop: act, step, store, sample, learn, for every method and all lanes at once.

A lane is a life with its seed. `depart`, `learn` and `arrive` are written for one lane and vmapped; between them the replay is
read and written unbatched, because it is one buffer. The gradient step of a control step samples what was stored before it, so
that a host can simulate while the accelerator learns (the release samples through a prefetched dataset, as late). Resets are a
select, not a branch: a branch under vmap would pay for both sides as well, and a select handles a lane's own resets, scheduled
interventions and later faults by one rule.
"""

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from earl_jax.algos import replay as replay_lib
from earl_jax.algos import sac as sac_lib
from earl_jax.algos.life import BINS, Keys, Lane, Lives, Loop, keys_of
from earl_jax.algos.method import TASK, Commands, Method
from earl_jax.algos.replay import Marks, Replay, Rows, Transition
from earl_jax.envs import State

UNLIKELY = -1.2345e38
"""A number that nothing here ever is, so that a comparison with it orders a program and changes nothing."""


class Outcome(NamedTuple):
    """How one step of a lane ended, bool scalars: the phase is `over` where the goal was `reached` or time ran out.

    A `fault` is an intervention of that lane alone: the simulation broke, and nothing of the step is kept. What `begins` anew is
    the task phase: after an intervention, and where the world asks for another goal during one (`switch`).
    """

    fault: jax.Array
    reached: jax.Array
    timeout: jax.Array
    over: jax.Array
    switch: jax.Array
    begins: jax.Array
    reset: jax.Array


def outcome_of(loop: Loop, method: Method, lane: Lane, world: State, keys: Keys, step: jax.Array) -> Outcome:
    """Return how the step that led `lane` to `world` ended: the one rule of done, for every method."""
    fault = loop.env.fault(world)
    reached = (
        loop.env.sparse & loop.env.success(world.obs) & method.ends_on_success(lane.phase) & ~fault & (world.done == 0)
    )
    intervene = lane.rules.intervened(step + 1, jax.random.fold_in(keys.reset, 1)) | fault
    switch = lane.rules.goal_changes(step + 1)
    begins = intervene | (switch & (lane.phase == TASK))
    expired = (lane.phase_step + 1 >= method.phase_length(loop.env, lane.phase)) | begins
    over = reached | expired
    return Outcome(fault, reached, expired & ~reached, over, switch, begins, intervene | (over & method.resets))


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
    end = outcome_of(loop, method, lane, world, keys, step)
    earned = env.goal_reward(world, table[lane.commands.task])
    tally = lane.tally.replace(
        window_reward=lane.tally.window_reward + jnp.where(end.fault, 0.0, earned),
        interventions=lane.tally.interventions + end.reset,
        faults=lane.tally.faults + end.fault,
        reached=lane.tally.reached + (end.reached & (lane.phase == TASK)),
    )
    phase = jnp.where(end.begins, TASK, jnp.where(end.over, (lane.phase + 1) % method.phases, lane.phase))
    commands = _commands(loop, method, lane, phase, keys.goal, end)
    onward = jax.tree.map(lambda new, old: jnp.where(end.reset, new, old), env.intervene(keys.reset, world), world)
    onward = env.with_goal(onward, table[commands.goal])

    before, after = lane.world.done > 0, world.done > 0
    marks = Marks(lane.commands.goal, end.reached, end.timeout, end.reset, after)
    for_ever = jnp.where(after, 1.0 / (1.0 - method.sac.discount), 1.0)
    reward = jnp.where(end.fault, 0.0, world.reward * for_ever)
    transition = Transition(action, onward.obs[: env.state_size], reward, marks)
    bootstrapped = end.timeout & jnp.asarray(method.sac.timeout_bootstrap, bool)
    phase_step = jnp.where(end.over, 0, lane.phase_step + 1)
    visits = None if lane.visits is None else _visited(loop, lane.visits, world.obs)
    lane = lane.replace(world=onward, phase=phase, phase_step=phase_step, commands=commands, tally=tally, visits=visits)
    return lane, transition, ~(end.reset & bootstrapped) & ~end.fault & ~before


def _commands(loop: Loop, method: Method, lane: Lane, phase: jax.Array, key: jax.Array, end: Outcome) -> Commands:
    """Return what is commanded after a step: where the world asks for goals itself, methods draw no other task than its own."""
    asks = lane.rules.goal_change > 0
    asked = jnp.where(end.switch, loop.goals.draw_task(jax.random.fold_in(key, 1)), lane.commands.task)
    goals = loop.goals._replace(asked=jnp.where(asks, asked, -1))
    fresh = method.next_goal(key, goals, phase, lane.commands._replace(task=asked), lane.extra)
    commands = jax.tree.map(lambda new, old: jnp.where(end.over, new, old), fresh, lane.commands)
    return commands._replace(task=jnp.where(asks, asked, commands.task))


def _visited(loop: Loop, visits: jax.Array, obs: jax.Array) -> jax.Array:
    low, high = np.asarray(loop.env.area)
    share = (loop.env.place(obs) - low) / (high - low)
    x, y = jnp.clip(jnp.floor(share * BINS), 0, BINS - 1).astype(jnp.int32)
    return visits.at[x, y].add(1)


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
        learnt = jax.vmap(lambda *each: learn(loop, *each))(method, lanes, keys, rows, lanes.phase)
        lanes = _unless_over(lanes, learnt) if loop.env.ends else learnt
        flight = _once_learnt(lanes.agent, flight)
    land = jax.vmap(lambda m, lane, one, away, key: arrive(loop, m, lane, one, away, key, step))
    lanes, transition, listed = land(method, lanes, action, flight, keys)
    return Lives(lanes, replay_lib.write(replay, transition, listed, controller), step + 1)


def _unless_over(lanes: Lane, learnt: Lane) -> Lane:
    """Return `learnt` lanes, and those whose world has come to its end as they were: nothing more is learnt there."""
    over = lanes.world.done > 0

    def keep(old, new):
        return jnp.where(over.reshape(-1, *[1] * (new.ndim - 1)), old, new)

    kept = [jax.tree.map(keep, old, new) for old, new in ((lanes.agent, learnt.agent), (lanes.extra, learnt.extra))]
    return learnt.replace(agent=kept[0], extra=kept[1])


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
