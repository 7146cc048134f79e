"""The parts that tasks share: a control step that starts and finishes separately, and the leash of a dragged hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import HelpBudget
from earl_jax.envs.mujoco_env import leashed_target
from earl_jax.physics import PendingStep
from tests.conftest import assert_all_finite, assert_equal_trees, make_problem, make_train_state, run_whole, tiny_method
from tests.envs.chain import LEFT, RIGHT, Chain

SPEEDS, LENGTHS = np.array([1.0, 4.0], np.float32), np.array([0.2, 0.08], np.float32)


class IntegerChain(Chain):
    """A chain whose pending step holds integers of its own, like the ticket of a host."""

    name = "integer_chain"

    def start_step(self, state, action):
        right = (self.checked_action(action) > 0).astype(jnp.int32)
        return PendingStep({"right": right, "position": state.data.astype(jnp.int32)})

    def finish_step(self, state, pending):
        action = 2.0 * pending.payload["right"] - 1.0
        state = state.replace(data=pending.payload["position"].astype(jnp.float32))
        return self.next_state(state, self.transition(state, action))


@pytest.mark.parametrize("wrap", [lambda task: task, lambda task: HelpBudget(task, budget=5.0)], ids=["plain", "help"])
def test_a_payload_of_integers_moves_as_the_plain_task_does(wrap):
    plain, integer = wrap(Chain(start=1)), wrap(IntegerChain(start=1))

    def step(env, action):
        return env.step(env.reset(jax.random.key(0)), jnp.append(action, jnp.full(env.action_size - 1, -1.0)))

    for action in (LEFT, RIGHT):
        both = jax.jit(lambda action: (step(plain, action), step(integer, action)))(action)
        assert_equal_trees(*both)


def test_a_task_with_a_payload_of_integers_is_trained():
    problem, method = make_problem(IntegerChain(eval_horizon=5, train_horizon=15)), tiny_method("naive")
    end = run_whole(problem, method, make_train_state(problem, method, [0, 1], 40), 40)
    assert_all_finite((end.replay, end.lanes.agent))
    moves = np.diff(np.asarray(end.replay.state)[:, :, 0], axis=0)
    resets = np.isin(np.arange(1, 41), [15, 30])
    assert (np.abs(moves[~resets]) <= 1).all()
    assert (moves != 0).any()
    assert end.lanes.counters.interventions.tolist() == [2, 2]


@pytest.mark.parametrize("fastest", [0.0, 1.0, 2.5, 4.0, 9.0])
def test_a_target_leads_the_hand_by_a_length_that_depends_on_the_fastest_joint(fastest):
    hand, length = np.array([0.1, 0.5, 0.0], np.float32), np.interp(fastest, SPEEDS, LENGTHS)
    leash = jax.jit(lambda target: leashed_target(target, hand, np.float32(fastest), SPEEDS, LENGTHS))
    far, near = hand + np.float32([0.9, 0, 0]), hand + np.float32([0.5 * length, 0, 0])
    np.testing.assert_allclose(leash(far), hand + np.array([length, 0, 0]), atol=1e-6)
    np.testing.assert_array_equal(leash(near), near)
