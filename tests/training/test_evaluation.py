"""Evaluations in training: what they measure, their columns, and that they change nothing else."""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import pytest

from earl_jax.algos import Learner, Method
from earl_jax.training.plan import per_lane
from tests.conftest import assert_equal_trees, evaluate, make_problem, make_train_state, tiny_method
from tests.envs.chain import Chain


def test_an_evaluation_repeats_and_changes_nothing_but_the_reward_window(problem):
    method = tiny_method("naive")
    state = make_train_state(problem, method, [0, 1])
    counters = state.lanes.counters.replace(window_reward=jnp.array([3.0, 0.0]))
    state = state.replace(lanes=state.lanes.replace(counters=counters), step=jnp.asarray(40, jnp.int32))
    after, metrics = evaluate(problem, method, state)
    assert metrics["continuing/reward"].tolist() == pytest.approx([3 / 40, 0.0])
    closed = counters.replace(window_reward=jnp.zeros(2), total_reward=jnp.array([3.0, 0.0]))
    assert_equal_trees(after, state.replace(lanes=state.lanes.replace(counters=closed)))
    again = evaluate(problem, method, after)[1]
    assert again["deployed/success"].tolist() == metrics["deployed/success"].tolist()
    assert again["deployed/return"].tolist() == metrics["deployed/return"].tolist()


class Answer(NamedTuple):
    metrics: dict


class Idle(NamedTuple):
    actor: tuple = ()


class Rest(Learner):
    """A baseline without parameters, which does not move."""

    name = "rest"

    def init(self, key, obs_size, action_size, entropy_free_pairs=0):
        return Idle()

    def act(self, key, actor, obs):
        return jnp.zeros(1)

    greedy = functools.partialmethod(act, None)

    def update(self, key, agent, batch):
        return agent, {}


def with_state(state, learner=Rest):
    """Return a method of two lanes whose own state is `state`."""
    return per_lane(type("Reporter", (Method,), {"name": "reporter", "init": lambda *_: state})(learner()), 2)


def test_scalars_in_the_metrics_of_a_method_are_metrics_and_a_learner_without_parameters_is_finite():
    """The metrics of a dict used to be left out, and such a learner a TypeError; those of an object have the wrong shape here."""
    problem = make_problem(Chain(eval_horizon=2), eval_every=40, eval_episodes=1)
    answer = {"metrics": {"answer": jnp.float32(42), "known": jnp.array(True)}}
    method = with_state(answer)
    metrics = evaluate(problem, method, make_train_state(problem, method, [0, 1]))[1]
    assert metrics["reporter/answer"].tolist() == [42.0, 42.0]
    assert metrics["reporter/known"].dtype == jnp.int32, "metrics.csv has numbers"
    assert metrics["diverged"].tolist() == [0, 0]
    wide = Answer({"answer": jnp.zeros(3)})
    odd = {
        r"'reporter/answer' of metrics.csv must be number\[\], not float32\[3\]": with_state(wide),
        "metrics in the state of method 'reporter' must be a dict of scalars": with_state({"metrics": jnp.zeros(())}),
    }
    for name in ("seed", "interventions"):
        learner = type("Odd", (Rest,), {"diagnostics": (name,)})
        odd[f"'{name}' is a column of every metrics"] = with_state(answer, learner)
    for message, method in odd.items():
        with pytest.raises(ValueError, match=message):
            evaluate(problem, method, make_train_state(problem, method, [0, 1]))
