"""The initial state of training: new agents, s0 ~ rho, and demonstrations as the first rows of the replay."""

import jax
import jax.numpy as jnp

from earl_jax.algos.goals import GoalIndices
from earl_jax.algos.learner import sac
from earl_jax.algos.method import TASK, Method
from earl_jax.metrics.continuing import Counters
from earl_jax.metrics.life import Life, init_life
from earl_jax.protocol import Rules
from earl_jax.training.demo_rows import demonstrations, init_replay
from earl_jax.training.state import MAP_BINS, LaneState, Problem, TrainState


def init_train_state(
    problem: Problem, method: Method, keys: jax.Array, capacity: int, rules: Rules | None = None
) -> TrainState:
    """Return N lanes at step 0 from PRNG keys [N]; leaves of `method` and `rules` have a leading lane axis.

    Without `rules`, every lane has those of the problem's protocol.
    """
    if rules is None:
        rules = jax.tree.map(lambda rule: jnp.full(keys.shape[0], rule), problem.protocol.rules)
    lanes = jax.vmap(lambda *lane: init_lane(problem, *lane))(method, keys, rules)
    replay = init_replay(problem, method, keys.shape[0], capacity)
    start = lanes.env_state.obs[None, :, : problem.env.state_size]
    state = jax.lax.dynamic_update_slice(replay.state, start, (replay.row, 0, 0))
    return TrainState(lanes, replay.replace(state=state), jnp.zeros((), jnp.int32))


def init_lane(problem: Problem, method: Method, key: jax.Array, rules: Rules) -> LaneState:
    """Return one lane at step 0."""
    env, goals = problem.env, problem.goals
    agent_key, method_key, env_key, goal_key, lane_key = jax.random.split(key, 5)
    method_state = method.init_state(method_key, env, goals)
    task = goals.draw_task(jax.random.fold_in(goal_key, 1))
    phase, phase_step = jnp.asarray(TASK, jnp.int32), jnp.zeros((), jnp.int32)
    goal_indices = method.next_goal(goal_key, goals, phase, GoalIndices(task, task), method_state)

    def init_agent(controller_key):
        return sac.init(controller_key, method.sac, env.obs_size, env.action_size, method.critics)

    agents = jax.vmap(init_agent)(jax.random.split(agent_key, method.controllers))
    pretrain_key = jax.random.fold_in(agent_key, 1)
    env_state = env.with_goal(env.reset(env_key), jnp.asarray(goals.table)[goal_indices.goal])
    return LaneState(
        key=lane_key,
        env_state=env_state,
        phase=phase,
        phase_step=phase_step,
        goal_indices=goal_indices,
        agent=method.pretrain(pretrain_key, env, agents, demonstrations(problem, method)),
        method_state=method_state,
        counters=_zero_counters(init_life(env, env_state)),
        rules=rules,
        visits=None if env.map_bounds is None else jnp.zeros((MAP_BINS, MAP_BINS), jnp.int32),
    )


def _zero_counters(life: Life) -> Counters:
    zero, none = jnp.zeros(()), jnp.zeros((), jnp.int32)
    return Counters(
        window_reward=zero,
        total_reward=zero,
        interventions=none,
        faults=none,
        reached=none,
        diagnostics=dict.fromkeys(sac.DIAGNOSTICS, zero),
        life=life,
    )
