"""MEDAL: its classifier, the reward that this gives, goals and phases, and who samples which demonstrations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos import make_algo
from earl_jax.algos.goals import goal_table
from earl_jax.algos.learner import replay as replay_lib
from earl_jax.algos.learner.networks import apply
from earl_jax.algos.medal import demonstrated_obs, demos_to_clone, mix
from earl_jax.algos.method import RETURN, TASK
from earl_jax.training.demos import demo_rows
from tests.algos.lives import PHASE, lived
from tests.algos.transitions import make_batch
from tests.conftest import take_lane, tiny_method

KEYS = jax.random.split(jax.random.key(0), 300)
sample_own = jax.jit(replay_lib.sample_own, static_argnums=(2, 3))


@pytest.fixture(scope="module")
def medal(env):
    """Return the method, the goals and the classifier's first state."""
    method, goals = make_algo("medal", learning_rate=1e-2), goal_table(env)
    return method, goals, jax.jit(lambda key: method.init(key, env, goals))(jax.random.key(0))


@pytest.fixture(scope="module")
def reward(env, medal):
    """Return the method's rewards as a program of batch, phase and classifier."""
    method, goals, _ = medal
    return jax.jit(lambda *arguments: method.prepare(KEYS[0], env, goals, *arguments).reward)


def test_a_refresh_tells_the_demonstrations_from_the_sampled_states(env, medal):
    method, goals, classifier = medal
    states = np.tile(goals.table[0] + 1.0, (method.refresh_batch_size, 1))
    batch = make_batch(states, states)

    @jax.jit
    def refreshed(classifier):
        def step(carry, key):
            after = method.refresh(key, env, goals, None, batch, carry)
            return after, after.metrics

        return jax.lax.scan(step, classifier, KEYS[:50])

    after, metrics = refreshed(classifier)
    assert metrics["classifier_loss"][-1] < 0.8 * metrics["classifier_loss"][0]
    assert metrics["classifier_accuracy"][-1] > 0.85
    own = np.concatenate([states[:1], goals.table[:1]], axis=1)
    assert apply(after.params, demonstrated_obs(env)).mean() > 0 > apply(after.params, own)[0, 0]


def test_mixup_takes_rows_and_labels_in_the_same_shares():
    rows, labels = jnp.eye(50), jnp.arange(50) % 2.0
    mixed, mixed_labels = jax.jit(mix)(jax.random.key(0), rows, labels)
    np.testing.assert_allclose(mixed.sum(axis=1), 1.0, rtol=1e-5)
    np.testing.assert_allclose(mixed @ labels, mixed_labels, atol=1e-6)
    shares = np.diag(np.asarray(mixed))
    assert (np.count_nonzero(mixed, axis=1) <= 2).all()
    assert shares.min() < 0.2
    assert shares[shares < 1].max() > 0.8


def test_the_backward_reward_is_the_released_formula(medal, reward):
    _, goals, classifier = medal
    batch = make_batch(goals.table[:3], goals.table[:3], reward=np.full(3, 0.25, np.float32))
    blank = jax.tree.map(np.zeros_like, classifier.params["params"])
    for logit in (-3.0, 0.0, 2.0, 40.0):
        last = {**blank["hidden_1"], "bias": np.float32([logit])}
        constant = classifier.replace(params={"params": {**blank, "hidden_1": last}})
        expected = -np.log(1 - 1 / (1 + np.exp(-logit)) + 1e-10)
        np.testing.assert_allclose(reward(batch, RETURN, constant), [expected] * 3, rtol=1e-4)
        np.testing.assert_array_equal(reward(batch, TASK, constant), batch.reward)


def test_the_reward_is_that_of_the_next_state_unless_a_reset_overwrote_it(medal, reward):
    _, goals, classifier = medal
    states, goal = goals.table[5:8], np.tile(goals.table[2], (3, 1))
    for lost, state in ((False, states + 1), (True, states)):
        odds = np.asarray(apply(classifier.params, np.concatenate([state, goal], axis=1)))[:, 0]
        rewards = reward(make_batch(states, states + 1, 2, no_successor=lost), RETURN, classifier)
        np.testing.assert_allclose(rewards, np.logaddexp(0, odds), rtol=1e-4)


def test_the_classifier_gets_states_of_ways_back_alone_and_waits_for_the_first_one(problem, medal):
    method, goals, classifier = medal
    _, start, end = lived("medal")
    keys, first = jax.random.split(jax.random.key(5), 2), int(start.replay.row)
    before, after = (sample_own(state.replay, keys, RETURN, method.refresh_batch_size) for state in (start, end))
    for lane in (0, 1):
        assert set(after.row[lane].tolist()) == set(range(first + PHASE, first + 2 * PHASE))
    assert not after.demonstrated.any()
    assert before.demonstrated.all()
    refresh = jax.jit(lambda own: method.refresh(KEYS[0], problem.env, goals, None, own, classifier))
    leaf, unchanged, moved = (
        jax.tree.leaves(state.params)[0]
        for state in (classifier, *(refresh(take_lane(own, 0)) for own in (before, after)))
    )
    np.testing.assert_array_equal(unchanged, leaf)
    assert np.abs(moved - leaf).max() > 1e-3


def test_the_backward_replay_has_forward_and_backward_demonstrations_under_each_goal(problem):
    demos = demo_rows(problem, tiny_method("medal"))
    forward, backward = [len(problem.env.demonstrations.load(name).ends) for name in ("forward", "backward")]
    assert len(demos.sampleable(TASK)) == forward
    assert len(demos.sampleable(RETURN)) == forward + 4 * backward
    assert len(demos.states) == len(problem.goals.candidates)


def test_backward_demonstrations_get_task_goals_on_ways_back_alone_and_each_controller_clones_its_own(medal, env):
    method, goals, classifier = medal
    demonstrated, backward = np.arange(400) % 2 == 0, np.arange(400) >= 200
    batch = make_batch(*np.zeros((2, 400, 6)), np.where(backward, goals.tasks, 1), demonstrated=demonstrated)
    prepare = jax.jit(lambda phase: method.prepare(KEYS[0], env, goals, batch, phase, classifier))
    forth, back = prepare(TASK), prepare(RETURN)
    np.testing.assert_array_equal(forth.flags.goal, batch.flags.goal)
    np.testing.assert_array_equal(forth.demonstrated, demonstrated)
    goal = np.asarray(back.flags.goal)
    np.testing.assert_array_equal(goal[~backward], 1)
    assert set(goal[backward & demonstrated].tolist()) == {0, 1, 2, 3}
    np.testing.assert_array_equal(goal[backward & ~demonstrated], goals.tasks)
    np.testing.assert_array_equal(back.demonstrated, demonstrated & backward)


@pytest.mark.parametrize("all_demos", [False, True])
def test_pretraining_clones_backward_demonstrations_under_each_task_goal(problem, all_demos):
    env = problem.env
    demos = demos_to_clone(
        env, demo_rows(problem, tiny_method("medal", all_demos=all_demos)).steps(problem.goals.table)
    )
    forward, backward = env.demonstrations.load("forward"), env.demonstrations.load("backward")
    assert len(demos.of(TASK).obs) == len(forward.ends) + all_demos * len(backward.ends)
    demonstrated = demonstrated_obs(env)
    assert demonstrated.shape == (len(forward.ends) + 12, 12)
    assert env.success(demonstrated[-12:]).all()
    own = demos.of(RETURN)
    assert len(own.obs) == 4 * len(backward.ends)
    goals = np.repeat(env.goal_states, len(backward.ends), axis=0)
    np.testing.assert_array_equal(own.obs[:, 6:], goals)
    np.testing.assert_array_equal(own.obs[: len(backward.ends), :6], backward.states)
    np.testing.assert_array_equal(own.action, np.tile(backward.actions, (4, 1)))
