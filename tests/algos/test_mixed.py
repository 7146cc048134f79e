"""Methods of the same shapes share a program, and every lane uses the hooks of its own method."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.algos.method import TASK, Method
from earl_jax.algos.mixed import MixedMethod, mix_methods, program_signature
from tests.compiler import EQUAL_BITS
from tests.conftest import assert_equal_trees, make_train_state, run_whole, take_lane, tiny_method


class Custom(Method):
    """Overrides every hook in which lanes of one program may differ."""

    factor: float = 3.0
    name = "custom"

    def phase_length(self, env, phase):
        return 7

    def ends_on_success(self, phase):
        return False

    def explores(self, key, env, phase, phase_step, method_state):
        return phase_step % 3 == 0

    def relabel(self, key, env, goals, batch, phase):
        return batch._replace(flags=batch.flags._replace(goal=batch.flags.goal * 0))

    def reward(self, env, goals, batch, phase, method_state):
        return self.factor * (batch.reward + 1)

    def terminal(self, batch, phase):
        return batch.flags.reached


def test_each_lane_trains_as_if_its_method_were_alone(env, problem):
    problem = dataclasses.replace(problem, env=dataclasses.replace(env, eval_horizon=25))
    naive = tiny_method("naive")
    methods = [naive, tiny_method("oracle"), Custom(naive.sac, jnp.array([3.0, 5.0]))]
    mixed = mix_methods(methods)
    assert isinstance(mixed, MixedMethod)
    np.testing.assert_array_equal(mixed.member, [0, 0, 1, 1, 2, 2])

    def train_lanes(method, seeds):
        start = make_train_state(problem, method, seeds, steps=60)
        return run_whole(problem, method, start, 60, compiler_options=EQUAL_BITS)

    state = train_lanes(mixed, [0, 1] * 3)
    for number, method in list(enumerate(methods))[1:]:
        alone = train_lanes(method, [0, 1])
        assert_equal_trees(take_lane(state.lanes, slice(2 * number, 2 * number + 2)), alone.lanes)
    np.testing.assert_array_equal(state.lanes.counters.interventions, [0, 0, 2, 2, 0, 0])
    assert int(state.lanes.phase_step[4]) == 60 % 7


@pytest.mark.parametrize("name", ["explore_hold", "later_steps"])
def test_methods_that_hold_actions_or_look_ahead_differently_share_no_program(name):
    naive = tiny_method("naive")
    other = type("Other", (Custom,), {name: 5})(naive.sac)
    assert program_signature(Custom(naive.sac)) == program_signature(naive)
    assert program_signature(other) != program_signature(naive)


def test_methods_of_one_class_are_joined_without_a_wrapper():
    first, second = tiny_method("vaprl", epsilon=0.1), tiny_method("vaprl", lanes=1, epsilon=0.3)
    joined = mix_methods([first, second])
    assert type(joined) is type(first)
    np.testing.assert_allclose(joined.epsilon, [0.1, 0.1, 0.3])


def test_methods_with_equal_signatures_can_share_a_program():
    naive = program_signature(tiny_method("naive"))
    assert naive == program_signature(tiny_method("oracle"))
    assert naive == program_signature(tiny_method("naive", lanes=3, reward_scale=1.0))
    for other in ("fbrl", "r3l", "vaprl"):
        assert program_signature(tiny_method(other)) != naive
    assert program_signature(tiny_method("naive", batch_size=8)) != naive
    assert program_signature(tiny_method("vaprl")) != program_signature(tiny_method("vaprl", value_samples=2))
    with pytest.raises(ValueError, match=r"can't share a program.*fbrl, naive"):
        mix_methods([tiny_method("naive"), tiny_method("fbrl")])


def test_each_lane_uses_the_hooks_of_its_member(env):
    mixed = mix_methods([tiny_method("naive", lanes=1), tiny_method("oracle", lanes=1)])
    phase = jnp.asarray(TASK)
    np.testing.assert_array_equal(jax.vmap(lambda m: m.phase_length(env, phase))(mixed), [1000, 200])
    np.testing.assert_array_equal(jax.vmap(lambda m: m.resets)(mixed), [False, True])
    assert (mixed.controllers, mixed.phases, mixed.critics, mixed.refresh_every) == (1, 1, 2, 0)
