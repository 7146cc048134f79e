"""Behaviour cloning: the actor learns the demonstrations before the first step, and nothing afterwards."""

import jax
import numpy as np

from earl_jax.algos import make_algo
from earl_jax.algos.learner.cloning import clone, cloning_loss
from earl_jax.envs import TaskDemos
from earl_jax.training.demos import demo_rows
from earl_jax.training.plan import make_plan
from tests.algos.lives import OPTIONS, lived
from tests.conftest import assert_equal_trees, make_train_state, take_lane, tiny_method


def test_cloning_lowers_the_error_on_the_demonstrations_of_each_controller(problem):
    learner = make_algo("bc", hidden_sizes=[16], batch_size=64, pretrain_steps=150, pretrain_rate=3e-3).learner
    demos = demo_rows(problem, tiny_method("bc", controllers=2)).steps(problem.goals.table)
    agents = jax.jit(jax.vmap(lambda key: learner.init(key, 12, 3)))(jax.random.split(jax.random.key(0), 2))
    cloned = jax.jit(lambda key, actors: clone(key, learner, actors, demos))
    actors, losses = cloned(jax.random.key(1), agents.actor)
    assert losses.shape == (2, 150)
    assert (losses[:, -20:].mean(axis=1) < 0.6 * losses[:, 0]).all()
    both = [jax.tree.map(lambda leaf, c=c: leaf[c], actors) for c in (0, 1)]
    loss = jax.jit(lambda actor, obs, action: cloning_loss(actor, learner, obs, action))
    cross = [[float(loss(actor, part.obs, part.action)) for actor in both] for part in (demos.of(0), demos.of(1))]
    assert cross[0][0] < cross[0][1]
    assert cross[1][1] < cross[1][0]


def test_bc_acts_greedily_and_does_not_learn():
    method, first, last = lived("bc")
    assert_equal_trees(last.lanes.agent, first.lanes.agent)
    lane, own = take_lane(first.lanes, 0), take_lane(method, 0)
    mode = jax.jit(own.learner.greedy)(take_lane(lane.agent.actor, 0), lane.env_state.obs)
    np.testing.assert_allclose(last.replay.action[int(first.replay.row), 0], mode, atol=1e-5)
    assert all(not np.asarray(value).any() for value in last.lanes.counters.diagnostics.values())


def test_bc_has_no_random_steps_unless_asked(problem):
    assert make_algo("bc").learner.random_steps == 0
    assert make_algo("bc", random_steps=20).learner.random_steps == 20
    assert make_algo("naive").learner.random_steps == 1000
    assert make_plan(problem, tiny_method("bc", random_steps=0), 2, 120).random_steps == 0


def test_any_method_can_clone_first_with_a_noise_of_its_choice(problem):
    """It has the actor of BC, whose noise plays no part."""
    methods = [tiny_method("risc", **OPTIONS["bc"], pretrain_log_std=std) for std in (None, -3.0)]
    noisy, quiet = (make_train_state(problem, own, [0, 1]).lanes.agent.actor["params"] for own in methods)
    cloned, tolerance = lived("bc").start.lanes.agent.actor["params"], {"rtol": 1e-4, "atol": 1e-5}
    for layers in (noisy, quiet):
        assert_equal_trees(layers["hidden_0"], cloned["hidden_0"], **tolerance)
    for name in ("kernel", "bias"):
        own, fixed, expected = (layers["hidden_1"][name] for layers in (noisy, quiet, cloned))
        np.testing.assert_allclose(own, expected, **tolerance)
        np.testing.assert_allclose(fixed[..., :3], expected[..., :3], **tolerance)
        np.testing.assert_array_equal(fixed[..., 3:], 0.0 if name == "kernel" else -3.0)


def test_bc_clones_forward_demonstrations_alone_where_there_are_no_others(problem, monkeypatch):
    both = demo_rows(problem, tiny_method("bc")).steps(problem.goals.table)
    monkeypatch.setattr(TaskDemos, "directions", property(lambda self: ("forward",)))
    forward = demo_rows(problem, tiny_method("bc", controllers=2)).steps(problem.goals.table)
    assert 0 < len(forward.obs) < len(both.obs)
    assert set(forward.controller.tolist()) == {0}
    assert len(forward.of(1).obs) == len(forward.obs)
