"""A whole lifetime as one pure function."""

import dataclasses

import jax
import numpy as np
import pytest

from earl_jax.algos import SAC, make_algo
from earl_jax.algos.naive import Naive
from earl_jax.envs import make
from earl_jax.training import lifetime
from earl_jax.training.state import Problem, seed_keys
from tests.conftest import RUN_STEPS, tiny_options, tiny_train


def test_a_lifetime_and_its_metrics_under_a_bare_jit_equal_training(problem):
    result = tiny_train("vaprl")
    method = make_algo("vaprl", **tiny_options("vaprl"))
    whole = dataclasses.replace(problem, steps=RUN_STEPS)
    train_state, metrics = jax.jit(lifetime)(whole, method, seed_keys(range(2)))
    for name, values in metrics.items():
        np.testing.assert_allclose(values, result.metrics[name], rtol=1e-3, atol=1e-4, err_msg=name)
    np.testing.assert_allclose(train_state.replay.action, result.train_state.replay.action, atol=1e-3)


def test_what_is_no_problem_method_number_of_steps_or_key_for_each_seed_is_refused(problem):
    naive, keys = Naive(), seed_keys(range(2))
    for arguments, message in (
        ((problem, naive, keys), "needs a number of steps"),
        ((problem, naive, keys, 2**31), r"steps must lie in \[1, "),
        *[
            ((problem, naive, wrong, 120), "keys must have one")
            for wrong in (keys[0], keys[None], jax.random.PRNGKey(0))
        ],
        ((problem, "naive", keys, 120), "the method must be an object of Method, not 'naive'"),
        ((problem, Naive(SAC(discount=2.0)), keys, 120), r"naive: discount must lie in \[0, 1\), not 2"),
        ((problem.env, naive, keys, 120), "the problem must be an object of Problem, not TabletopOrgan"),
    ):
        with pytest.raises(ValueError, match=message):
            lifetime(*arguments)
    with pytest.raises(ValueError, match=r"static under jit: use Problem.*static_argnames"):
        jax.jit(lifetime)(problem, naive, keys, 120)


@pytest.mark.parametrize("random_steps", [0, 20, RUN_STEPS])
def test_a_lifetime_contains_the_physics_of_training_and_of_evaluation_once(problem, random_steps):
    """Each part takes XLA long to compile on MJX; here engine c stands for it, whose calls are easy to count."""
    cheetah = Problem(make("cheetah_run", engine="c", eval_horizon=5), problem.protocol, steps=RUN_STEPS)
    method = make_algo("naive", **{**tiny_options("naive"), "random_steps": random_steps})
    program = jax.make_jaxpr(lambda keys: lifetime(cheetah, method, keys))(seed_keys(range(2)))
    assert str(program).count("ffi_call[") == 2
