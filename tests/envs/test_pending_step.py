"""Tasks whose control step starts and finishes separately with a payload of their own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from earl_jax.envs import HelpBudget
from earl_jax.physics import PendingStep
from tests.conftest import TINY, assert_all_finite, assert_equal_trees, without_shares
from tests.envs.chain import LEFT, RIGHT, Chain


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


@pytest.mark.parametrize("action", [LEFT, RIGHT])
def test_a_payload_of_integers_moves_as_the_plain_task_does(action):
    key = jax.random.key(0)
    plain, integer = Chain(start=1), IntegerChain(start=1)
    assert_equal_trees(integer.step(integer.reset(key), action), plain.step(plain.reset(key), action))
    plain, integer = (HelpBudget(task, budget=5.0) for task in (plain, integer))
    action = np.append(action, -1.0)
    assert_equal_trees(integer.step(integer.reset(key), action), plain.step(plain.reset(key), action))


def test_a_task_with_a_payload_of_integers_is_trained():
    env = IntegerChain(eval_horizon=5, train_horizon=15)
    method = earl_jax.make_algo("naive", **TINY)
    result = earl_jax.train(env, method, seeds=2, steps=40, eval_every=40, eval_episodes=2)
    replay = result.train_state.replay
    assert_all_finite((replay, result.train_state.lanes.agent, without_shares(result.metrics)))
    moves = np.diff(np.asarray(replay.state)[:, :, 0], axis=0)
    resets = np.isin(np.arange(1, 41), [15, 30])
    assert (np.abs(moves[~resets]) <= 1).all()
    assert (moves != 0).any()
    assert result.metrics["interventions"].tolist() == [[2], [2]]
    assert result.metrics["critic_loss"].min() > 0
