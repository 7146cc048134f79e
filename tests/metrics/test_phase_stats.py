"""The metrics of a life from counts whose values are known: phases and movements."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.metrics import phase_stats
from earl_jax.metrics.phase_stats import ALIVE, BACK, FORWARD, STILL

FORWARD_PHASE, BACK_PHASE = True, False


@pytest.fixture(scope="module")
def start(env):
    return jax.jit(env.reset)(jax.random.key(0))


@pytest.fixture(scope="module")
def after(env, start):
    """Return a function that gives the counts after `steps`: mug's x, phase, over, at its goal."""

    def mug_at(x):
        return start.replace(data=start.data.replace(qpos=jnp.array([0.0, 0.0, x, 0.0])))

    first = jax.jit(lambda: phase_stats.init_phase_stats(env, mug_at(0.0)))()
    advance = jax.jit(lambda life, x, *rest: phase_stats.advance_phase_stats(life, env, mug_at(x), *rest))

    def after(*steps):
        life, age = first, 0
        for number, (x, *flags) in enumerate(steps, 1):
            life = advance(life, x, *map(np.asarray, flags), number, age)
            age = 0 if flags[1] else age + 1
        return life

    return after


def values(life, step, alive_steps=3, phases=2, sparse=True):
    life, metrics = phase_stats.phase_metrics(life, jnp.asarray(step), alive_steps, phases, sparse)
    return life, {name: float(value) for name, value in metrics.items()}


def test_success_shares_count_the_phases_that_ended_since_the_last_evaluation(after):
    steps = [(0.0, FORWARD_PHASE, True, True), (0.0, FORWARD_PHASE, True, False), (0.0, BACK_PHASE, True, True)]
    life, first = values(after(*steps, (0.0, BACK_PHASE, False, False)), 4)
    assert (first[FORWARD], first[BACK]) == (0.5, 1.0)
    _, second = values(life, 4)
    assert np.isnan([second[FORWARD], second[BACK]]).all()
    left = [(0.0, phase, over, at_goal) for phase in (FORWARD_PHASE, BACK_PHASE) for over, at_goal in ((0, 1), (1, 0))]
    phases = after(*left, (0.0, FORWARD_PHASE, True, False))
    assert (phases.ended.tolist(), phases.reached.tolist()) == ([2, 1], [1, 1]), "at its goal once is enough"


def test_a_lane_is_alive_if_both_directions_were_reached_recently(after):
    both = after((0.0, FORWARD_PHASE, True, True), (0.0, BACK_PHASE, True, True))
    assert values(both, 4)[1][ALIVE] == 1
    assert values(both, 5)[1][ALIVE] == 0, "the forward goal was reached 4 steps ago"
    assert values(both, 5, alive_steps=4)[1][ALIVE] == 1
    stuck = after((0.0, FORWARD_PHASE, True, True), (0.0, BACK_PHASE, True, False))
    assert values(stuck, 3)[1][ALIVE] == 1, "too young to be lost"
    assert values(stuck.replace(reached_at=jnp.array([9, 0])), 9)[1][ALIVE] == 0


def test_a_direction_without_a_goal_does_not_count(after):
    forward_only = after((0.0, FORWARD_PHASE, True, True)).replace(reached_at=jnp.array([9, 0]))
    assert values(forward_only, 9)[1][ALIVE] == 1
    assert values(forward_only, 9, phases=1)[1].keys() == {FORWARD, ALIVE, STILL}
    assert values(forward_only, 9, sparse=False)[1].keys() == {STILL}


def test_an_object_rests_until_it_is_a_centimetre_from_where_it_lay(after):
    steps = [(x, FORWARD_PHASE, False, False) for x in (0.5, 0.505, 0.506, 0.507)]
    assert values(after(*steps), 4)[1][STILL] == 3
    creeping = [(0.006 * number, FORWARD_PHASE, False, False) for number in range(1, 4)]
    assert values(after(*creeping), 3)[1][STILL] == 1, "slow movements add up"
    assert values(after((0.0, FORWARD_PHASE, False, False)), 1)[1][STILL] == 1
