"""RISC: phases that the method ends, the probability with which it does so, and the critics that it reads."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from earl_jax.algos import make_algo
from earl_jax.algos.learner.sac import SOFT_CRITICS
from earl_jax.algos.method import RETURN, TASK, Moment

KEYS = jax.random.split(jax.random.key(0), 4000)
OBS = jnp.zeros(12)


def moment(phase_step):
    return Moment(jnp.asarray(phase_step), jnp.asarray(TASK), phase_step, KEYS[0])


def with_value(agent, value, weights=0.0):
    """Return `agent` with further critics that are `value` everywhere, or vary around it with a share `weights` of theirs.

    This is before the division by the reward scale.
    """
    critics = jax.tree.map(lambda leaf: leaf.at[SOFT_CRITICS:].multiply(weights), agent.critics["params"])
    bias = critics["hidden_1"]["bias"].at[SOFT_CRITICS:].set(value)
    return agent.replace(critics={"params": {**critics, "hidden_1": {**critics["hidden_1"], "bias": bias}}})


@pytest.fixture(scope="module")
def agent():
    """An agent with success critics."""
    method = make_algo("risc", hidden_sizes=[16])
    return jax.jit(lambda key: method.learner.init(key, 12, 3, method.entropy_free_pairs))(KEYS[0])


@pytest.fixture(scope="module")
def switch_share(env, agent):
    """Return a function that gives the share of 4000 keys with which a method leaves a phase after `count` steps.

    Its further critics are `value` everywhere, before the division by the reward scale.
    """

    @jax.jit
    def share(method, value, count):
        own = jax.tree.map(lambda leaf: leaf[None], with_value(agent, value))
        return jax.vmap(lambda key: method.ends_phase(key, env, own, OBS, moment(count - 1), ()))(KEYS).mean()

    return lambda value, count, **options: float(share(make_algo("risc", hidden_sizes=[16], **options), value, count))


def test_of_two_controllers_the_acting_one_is_asked(env, agent):
    method = make_algo("risc", hidden_sizes=[16], controllers=2, conservative_factor=0.0)
    agents = jax.tree.map(lambda *leaves: jnp.stack(leaves), with_value(agent, 0.0), with_value(agent, 10.0))
    moments = [moment(jnp.asarray(150))._replace(phase=jnp.asarray(phase)) for phase in (TASK, RETURN)]
    ends = jax.jit(lambda at: method.ends_phase(KEYS[0], env, agents, OBS, at, ()))
    assert list(map(ends, moments)) == [False, True]


def test_the_probability_of_success_is_averaged_over_actions(agent):
    around_half = with_value(agent, 0.5, weights=1.0)

    def spread(samples):
        method = make_algo("risc", hidden_sizes=[16], value_samples=samples, reward_scale=1.0)
        return float(jax.jit(jax.vmap(lambda key: method.success_chance(key, around_half, OBS)))(KEYS).std())

    assert spread(4) / spread(1) == pytest.approx(0.5, abs=0.05)


def test_risc_never_switches_early_or_in_dense_tasks_or_without_switching(env, switch_share):
    assert [switch_share(10.0, count) for count in (99, 100)] == [0.0, 1.0]
    assert switch_share(10.0, 149, earliest_switch=0.75) == 0.0
    at_60 = {"earliest_switch": 0.3, "conservative_factor": 0.5}
    assert [switch_share(10.0, count, **at_60) for count in (59, 60)] == [0.0, 1.0]
    for method, task in (
        (make_algo("risc"), dataclasses.replace(env, reward_type="dense")),
        (make_algo("risc", switching=False), env),
    ):
        ends = [bool(method.ends_phase(KEYS[0], task, None, OBS, moment(jnp.asarray(age)), ())) for age in (150, 199)]
        assert ends == [False, True]
    assert make_algo("risc", switching=False, fixed_phases=True).entropy_free_pairs == 0
    with pytest.raises(ValueError, match="fixed_phases excludes switches, which end phases early; add switching=false"):
        make_algo("risc", fixed_phases=True)


@pytest.mark.parametrize(
    ("options", "value", "count", "expected"),
    [
        ({}, 3.0, 150, 0.3),
        ({"switch_share": 0.5}, 10.0, 150, 0.5),
        ({"earliest_switch": 0.0}, 10.0, 2, 1 - 0.9**2),
        ({"earliest_switch": 0.0, "conservative_factor": 0.5}, 8.0, 1, 0.4),
        ({}, 25.0, 150, 1.0),
        ({}, -5.0, 150, 0.0),
        ({"reward_scale": 1.0}, 0.3, 150, 0.3),
    ],
)
def test_the_chance_of_a_switch_is_share_p_and_one_minus_k_to_the_c(switch_share, options, value, count, expected):
    assert switch_share(value, count, **options) == pytest.approx(expected, abs=0.03)
