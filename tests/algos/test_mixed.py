"""Methods of the same shapes share a program, and every lane keeps its own method's answers."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.method import TASK, Method
from earl_jax.algos.mixed import Mixed, form, together
from tests.conftest import SHIPPED, advance, assert_same, newborn, tiny_method


class Strange(Method):
    """Reaches its goals without end, scales rewards and counts only part of what is terminal."""

    factor: float = 3.0
    name = "strange"

    def phase_length(self, env, phase):
        return 7

    def ends_on_success(self, phase):
        return False

    def relabel(self, key, env, goals, rows):
        return rows._replace(flags=rows.flags._replace(goal=rows.flags.goal * 0))

    def reward(self, rows, phase, method_state):
        return self.factor * (rows.reward + 1)

    def terminal(self, rows):
        return rows.flags.reached


def lanes_of(lives, span):
    return jax.tree.map(lambda leaf: leaf[span], lives.lanes)


def test_each_lane_lives_as_if_its_method_were_alone(env, problem):
    env = dataclasses.replace(env, eval_horizon=25)
    problem = dataclasses.replace(problem, env=env)
    naive = tiny_method("naive")
    methods = [naive, tiny_method("oracle"), Strange(naive.sac, jnp.array([3.0, 5.0]))]
    mixed = together(methods)
    assert isinstance(mixed, Mixed)
    np.testing.assert_array_equal(mixed.member, [0, 0, 1, 1, 2, 2])

    def lived(method, seeds):
        state_from_demo = newborn(problem, method, seeds, steps=60)
        explored = advance(problem, method, state_from_demo, 20, explore=True, compiler=SHIPPED)
        return advance(problem, method, explored, 40, compiler=SHIPPED)

    whole = lived(mixed, [0, 1] * 3)
    for number, method in list(enumerate(methods))[1:]:
        alone = lived(method, [0, 1])
        assert_same(alone.lanes, lanes_of(whole, slice(2 * number, 2 * number + 2)))
    np.testing.assert_array_equal(whole.lanes.counters.interventions, [0, 0, 2, 2, 0, 0])
    assert int(whole.lanes.phase_step[4]) == 60 % 7


def test_one_kind_stays_itself_and_keeps_its_values():
    one, other = tiny_method("vaprl", epsilon=0.1), tiny_method("vaprl", lanes=1, epsilon=0.3)
    both = together([one, other])
    assert type(both) is type(one)
    np.testing.assert_allclose(both.epsilon, [0.1, 0.1, 0.3])


def test_forms_tell_what_can_share_a_program():
    naive = form(tiny_method("naive"))
    assert naive == form(tiny_method("oracle")) == form(tiny_method("naive", lanes=3, reward_scale=1.0))
    for other in ("fbrl", "r3l", "vaprl"):
        assert form(tiny_method(other)) != naive
    assert form(tiny_method("naive", batch_size=8)) != naive
    assert form(tiny_method("vaprl")) != form(tiny_method("vaprl", value_samples=2))
    with pytest.raises(ValueError, match=r"can't share a program.*fbrl, naive"):
        together([tiny_method("naive"), tiny_method("fbrl")])


def test_answers_keep_their_member(env, problem):
    mixed = together([tiny_method("naive", lanes=1), tiny_method("oracle", lanes=1)])
    phase = jnp.asarray(TASK)
    np.testing.assert_array_equal(jax.vmap(lambda m: m.phase_length(env, phase))(mixed), [1000, 200])
    np.testing.assert_array_equal(jax.vmap(lambda m: m.resets)(mixed), [False, True])
    assert (mixed.controllers, mixed.phases, mixed.critics, mixed.refresh_every) == (1, 1, 2, 0)
