"""Behaviour cloning: the actor learns the demonstrations before the first step, and nothing afterwards."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import InputError
from earl_jax.algos import make_algo
from earl_jax.algos.learner import sac
from earl_jax.algos.learner.cloning import clone, cloning_loss
from earl_jax.algos.method import RETURN, TASK
from earl_jax.envs import make
from earl_jax.training import lifetime
from earl_jax.training.demo_rows import demonstrations
from earl_jax.training.plan import prepare
from earl_jax.training.state import seed_keys
from tests.conftest import (
    advance,
    assert_equal_trees,
    make_problem,
    make_train_state,
    take_lane,
    tiny_method,
    tiny_train,
    without_shares,
)

CLONED = {"pretrain_steps": 60, "pretrain_rate": 3e-3}


def lane_actor(state, lane=0, controller=0):
    return jax.tree.map(lambda leaf: leaf[lane, controller], state.lanes.agent.actor)


def test_cloning_lowers_the_error_on_the_demonstrations_of_each_controller(problem):
    method, agent_sac = tiny_method("bc", controllers=2), make_algo("bc", hidden_sizes=[16], batch_size=64).sac
    demos = demonstrations(problem, method)
    agents = jax.jit(jax.vmap(lambda key: sac.init(key, agent_sac, 12, 3)))(jax.random.split(jax.random.key(0), 2))
    actors, losses = jax.jit(lambda key, actors: clone(key, agent_sac, actors, demos, 150, 3e-3))(
        jax.random.key(1), agents.actor
    )
    assert losses.shape == (2, 150)
    assert (losses[:, -20:].mean(axis=1) < 0.6 * losses[:, 0]).all()
    both = [jax.tree.map(lambda leaf, c=c: leaf[c], actors) for c in (0, 1)]
    loss = jax.jit(lambda actor, obs, action: cloning_loss(actor, agent_sac, obs, action))
    cross = [[float(loss(actor, part.obs, part.action)) for actor in both] for part in (demos.of(0), demos.of(1))]
    assert cross[0][0] < cross[0][1]
    assert cross[1][1] < cross[1][0]


def test_bc_acts_by_its_mode_and_does_not_learn(problem):
    method = tiny_method("bc", random_steps=0, **CLONED)
    first = make_train_state(problem, method, [0, 1])
    last = advance(problem, method, first, 40)
    assert_equal_trees(last.lanes.agent, first.lanes.agent)
    lane, own = take_lane(first.lanes, 0), take_lane(method, 0)
    obs, actor = lane.env_state.obs, lane_actor(first)
    np.testing.assert_allclose(
        sac.act(own.sac, actor, obs, jax.random.key(3), 3), sac.greedy(own.sac, actor, obs, 3), atol=1e-6
    )
    start = int(first.replay.row)
    np.testing.assert_allclose(last.replay.action[start, 0], sac.greedy(own.sac, actor, obs, 3), atol=1e-5)
    assert all(not np.asarray(value).any() for value in last.lanes.counters.diagnostics.values())


def test_bc_alternates_task_goals_and_initial_states(env):
    problem = make_problem(dataclasses.replace(env, eval_horizon=15))
    method = tiny_method("bc", random_steps=0, **CLONED)
    state, seen = make_train_state(problem, method, [0, 1]), []
    for _ in range(2):
        is_task = np.asarray(state.lanes.goal_indices.goal) < problem.goals.tasks
        np.testing.assert_array_equal(is_task, np.asarray(state.lanes.phase) == TASK)
        seen += np.asarray(state.lanes.phase).tolist()
        state = advance(problem, method, state, 20)
    assert set(seen) == {TASK, RETURN}


def test_bc_has_no_random_steps_unless_asked_and_clones_inside_the_first_program(problem):
    assert make_algo("bc").sac.random_steps == 0
    assert make_algo("bc", random_steps=20).sac.random_steps == 20
    assert make_algo("naive").sac.random_steps == 1000
    assert prepare(problem, tiny_method("bc", random_steps=0), 2, 120).random_steps == 0
    method = tiny_method("bc", random_steps=0, **CLONED)
    demos = demonstrations(problem, method)
    errors = [
        float(cloning_loss(lane_actor(make_train_state(problem, m, [0, 1])), m.sac, demos.obs, demos.action))
        for m in (method, tiny_method("bc", random_steps=0, pretrain_steps=1))
    ]
    assert errors[0] < 0.8 * errors[1]


def test_any_method_can_clone_first_and_has_the_actor_of_bc(problem):
    options = {"random_steps": 0, "pretrain_log_std": -20.0, **CLONED}
    cloned = make_train_state(problem, tiny_method("bc", **options), [0, 1])
    for algo in ("risc", "vaprl"):
        actor = make_train_state(problem, tiny_method(algo, **options), [0, 1]).lanes.agent.actor
        assert_equal_trees(actor, cloned.lanes.agent.actor, rtol=1e-4, atol=1e-5)
    noisy = make_train_state(problem, tiny_method("risc", **{**options, "pretrain_log_std": None}), [0, 1])
    kernels = [state.lanes.agent.actor["params"]["hidden_1"]["kernel"][..., 3:] for state in (noisy, cloned)]
    assert [bool(kernel.any()) for kernel in kernels] == [True, False]
    with pytest.raises(InputError, match="naive needs demonstrations to clone, and minitaur_pen has none"):
        prepare(make_problem(make("minitaur_pen"), eval_every=40), tiny_method("naive", pretrain_steps=5), 2, 120)


def test_bc_clones_forward_demonstrations_alone_where_there_are_no_others(problem, monkeypatch):
    both = demonstrations(problem, tiny_method("bc"))
    monkeypatch.setattr(type(problem.env), "demo_directions", property(lambda self: ("forward",)))
    method = tiny_method("bc", controllers=2)
    forward = demonstrations(problem, method)
    assert 0 < len(forward.obs) < len(both.obs)
    assert set(forward.controller.tolist()) == {0}
    assert len(forward.of(1).obs) == len(forward.obs)


def test_bc_needs_demonstrations():
    env = make("minitaur_pen")
    with pytest.raises(InputError, match="bc needs demonstrations to clone, and minitaur_pen has none"):
        prepare(make_problem(env, eval_every=40), tiny_method("bc"), 2, 120)


def test_bc_trains_by_name_with_finite_metrics():
    result = tiny_train("bc", random_steps=0, **CLONED)
    assert all(np.isfinite(values).all() for values in without_shares(result.metrics).values())
    assert not result.metrics["critic_loss"].any()
    assert jnp.isfinite(result.policy(0)(jnp.zeros(12))).all()


def test_a_lifetime_without_random_steps_is_one_program(problem):
    method = make_algo("bc", hidden_sizes=[16], batch_size=16, pretrain_steps=1)
    _, metrics = jax.eval_shape(lambda keys: lifetime(problem, method, keys, 120), seed_keys([0, 1]))
    assert {value.shape for value in metrics.values()} == {(2, 3)}
