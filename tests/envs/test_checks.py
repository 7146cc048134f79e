"""A task with odd goals or functions is refused before it is used."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from earl_jax.adapters.gymnasium import ResetFreeEnv
from earl_jax.envs.tabletop import TabletopOrganization
from earl_jax.errors import InputError
from earl_jax.metrics.deployed import deployed
from earl_jax.protocol import Protocol, advance, init
from earl_jax.training import Problem
from tests.envs.chain import Chain


@pytest.mark.parametrize(
    ("member", "value", "message"),
    [
        ("goal_states", np.array([[0.0], [np.nan]]), "goal_states must be a NumPy array with rows of finite numbers"),
        ("goal_states", np.array([["a"]]), "goal_states must be a NumPy array"),
        ("goal_states", property(lambda env: jnp.ones((1, 1))), "goal_states must be a NumPy array"),
        ("initial_states", np.array([[np.inf]]), "initial_states must be a NumPy array"),
        ("initial_states", np.zeros((1, 2)), r"one length, not goal_states \[2, 1\] and initial_states \[1, 2\]"),
        ("success", lambda env, obs: 1.0 * (obs[..., 0] == obs[..., 1]), r"success of obs \[1, 4, 2\] must .*, not float32"),
        ("success", lambda env, obs: obs[0] == obs[1], r"success of .* bool\[1, 4\], not bool\[4, 2\]"),
        ("success", lambda env, obs: False, r"success of .* must be bool\[1, 4\], not bool\[\]"),
        ("reward", lambda env, obs: obs[..., :1], r"reward of .* number\[1, 4\], not float32\[1, 4, 1\]"),
        ("reward", lambda env, obs: -jnp.abs(obs[..., 0] - obs[..., 1]), "the success bit, but reward is .*'dense'"),
        ("reward", lambda env, obs: 10.0 * env.success(obs), r"the success bit, but reward is .*, 10.0\]\] where"),
        ("success", lambda env, obs: obs[..., 0] > obs[..., 1] + 1, "that equals its goal must be a success, but success is"),
    ],
)  # fmt: skip
def test_odd_goals_and_functions_are_refused_by_training_adapters_and_a_loop_of_ones_own(member, value, message):
    """A negative distance as the sparse reward used to train on the success bit without a word."""
    env = type("Odd", (Chain,), {member: value})()
    for use in (
        lambda: earl_jax.train(env, "naive", seeds=1, steps=40, eval_every=40),
        lambda: ResetFreeEnv(env),
        lambda: init(env, Protocol(0, 4), jax.random.key(0)),
    ):
        with pytest.raises(InputError, match=f"chain: .*{message}"):
            use()


@pytest.mark.parametrize(
    ("member", "value", "message"),
    [
        ("fault", lambda env, state: None, r"what fault returns must be bool\[\], not None"),
        ("intervene", lambda env, key, state: None, r"intervene must return the state with .*, but .data was float32\[1\] and"),
        ("state_size", 2, r"a state vector has shape \(1,\), not \(2,\)"),
        ("transition", lambda env, state, action: (1, 2), r"a step must return \(data, vector, info\), not a tuple of 2"),
        ("transition", lambda env, state, action: (state.data, 1, {"count": 1}), "sets count in info, .* too; reset sets goal"),
        ("reset", lambda env, key: Chain.reset(env, key).replace(data=jnp.zeros(1, jnp.int32)), r".data was int32\[1\]"),
        ("reset", lambda env, key: (jnp.zeros(2), Chain.reset(env, key)), r"reset must return a State, from make_state, not \("),
        ("reset", lambda env, key: env.make_state(None, jnp.zeros(1), {"x": 1}), r"must have the goal, not only \['x'\]"),
        ("goal_reward", lambda env, state, goal: jnp.zeros(2), r"what goal_reward returns must be number\[\], not float32\[2\]"),
    ],
)  # fmt: skip
def test_a_life_refuses_what_a_function_of_a_state_may_not_return(member, value, message):
    env, protocol = type("Odd", (Chain,), {member: value})(), Protocol(8, 4)
    with pytest.raises(InputError, match=f"chain: .*{message}"):
        advance(env, init(env, protocol, jax.random.key(0)), jnp.ones(1))


def test_an_override_of_step_is_refused_because_training_would_not_call_it():
    with pytest.raises(
        InputError, match=r"Odd\.step: training calls start_step and finish_step instead; override finish_st"
    ):
        type("Odd", (Chain,), {"step": lambda env, state, action: state})


def test_wide_starts_that_differ_from_reset_name_the_leaf():
    def reset(env, key):
        state = TabletopOrganization.reset(env, key)
        return state.replace(info={**state.info, "extra": jnp.zeros(())})

    env = type("Odd", (TabletopOrganization,), {"reset": reset})()
    message = (
        r"starts.wide must return a state with the same leaves, but .info\['extra'\] was float32\[1\] and is missing"
    )
    with pytest.raises(InputError, match=message):
        deployed(env, lambda obs: jnp.zeros(3), jax.random.key(0), 2, 1, wide=env.starts.wide)


def test_a_control_that_returns_the_command_alone_is_refused():
    env = type("Odd", (type(earl_jax.make("fish_swim")),), {"control": lambda env, state, action: action})()
    with pytest.raises(InputError, match=r"fish_swim: control must return \(data, command\), not an object of"):
        env.start_step(jax.eval_shape(env.reset, jax.random.key(0)), jnp.zeros(5))


def test_goals_of_whole_numbers_keep_the_types_of_a_life():
    """The first goal used to be int32 and every later one float32, which a scan refuses."""
    env = type("Whole", (Chain,), {"goal_states": np.array([[3], [0]]), "initial_states": np.array([[0]])})()
    state = init(env, Protocol(0, 4), jax.random.key(0))
    assert jax.lax.scan(lambda s, _: (advance(env, s, jnp.ones(1))[0], None), state, length=2)[0].step == 2


def test_the_reward_of_a_state_is_float32_also_of_a_task_that_returns_the_success_bit():
    env = type("Bit", (Chain,), {"reward": Chain.success})(start=2)
    state = env.step(env.reset(jax.random.key(0)), jnp.ones(1))
    assert state.reward.dtype == env.reset(jax.random.key(0)).reward.dtype == jnp.float32


def test_a_problem_can_be_made_in_a_program_that_is_traced():
    class New(Chain):
        """A task that no earlier test has checked."""

    assert jax.jit(lambda x: x + Problem(New(), Protocol(0, 4)).env.state_size)(1) == 2
