"""Help, budgets and the end of a life, on a chain whose every answer is known by hand, and on real tasks."""

import dataclasses
import itertools
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.envs import Env, HelpBudget, make
from earl_jax.protocol import Protocol
from earl_jax.training import loop as autonomy
from earl_jax.training.state import Problem
from tests.conftest import assert_same, newborn, plain, tiny_method

LEFT, RIGHT, HELP = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]], np.float32)
DISCOUNT = 0.9


@dataclasses.dataclass(frozen=True)
class Chain(Env):
    """Places 0 to `cliff`, off which nobody climbs; a positive action goes right, another left, which `fragile` breaks at 0."""

    cliff: int = 4
    start: int = 0
    goal: int = 3
    fragile: bool = False

    name: ClassVar[str] = "chain"
    action_size: ClassVar[int] = 1
    goal_change: ClassVar[int] = 10
    state_size: ClassVar[int] = 1
    goal_size: ClassVar[int] = 1

    @property
    def goal_states(self):
        return np.array([[self.goal], [0.0]], np.float32)

    @property
    def initial_states(self):
        return np.array([[self.start]], np.float32)

    def reset(self, key):
        place = jnp.full(1, self.start, jnp.float32)
        return self._state(place, place, {"goal": self.sample_goal(key)})

    def _land(self, state, flight):
        moved = state.data + jnp.where(flight > 0, 1.0, -1.0)
        moved = jnp.where(self.fragile & (moved < 0), jnp.nan, jnp.clip(moved, 0.0, self.cliff))
        return moved, moved, {}

    def success(self, obs):
        return jnp.abs(obs[..., 0] - obs[..., 1]) < 0.5

    def reward(self, obs):
        return self.success(obs).astype(jnp.float32) if self.sparse else -jnp.abs(obs[..., 0] - obs[..., 1])

    def irreversible(self, state):
        return super().irreversible(state) | (state.data[0] >= self.cliff)


def born(env, place=None, asked=0, enforced=0):
    """A life of `env` towards the chain's goal, at `place` with so many interventions behind it."""
    state = env.with_goal(env.reset(jax.random.key(0)), jnp.asarray(env.goal_states[0]))
    if place is None:
        return state
    where = jnp.full(1, place, jnp.float32)
    inner = env.task._state(where, where, state.data.info)
    left = jnp.float32(env.budget - asked * env.help_cost - enforced * env.enforced_cost)
    return env._seen(inner, {**state.info, "asked": jnp.int32(asked), "enforced": jnp.int32(enforced), "budget": left})


def lived(env, actions, state=None):
    """The states [T + 1] of a life under `actions [T, a]`."""
    first = born(env) if state is None else state
    advance = jax.jit(lambda state, plan: jax.lax.scan(lambda s, a: (env.step(s, a),) * 2, state, plan))
    _, rest = advance(first, jnp.asarray(actions))
    return jax.tree.map(lambda one, more: jnp.concatenate([jnp.asarray(one)[None], more]), first, rest)


def described(tree):
    """Shape, dtype and weak type of every leaf, of arrays or of what stands for them."""
    return jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype, leaf.weak_type), jax.eval_shape(lambda x: x, tree))


@pytest.mark.parametrize(("budget", "cost", "last"), [(3.0, 1.0, 12), (2.5, 1.0, 12), (1.0, 0.25, 16), (1.0, 0.0, 99)])
def test_always_right_falls_every_four_steps_and_ends_with_the_last_intervention_it_could_not_pay(budget, cost, last):
    env = HelpBudget(Chain(), budget=budget, enforced_cost=cost)
    life, time = lived(env, np.tile(RIGHT, (20, 1))), np.arange(21)
    falls, over = np.minimum(time, last) // 4, time >= last
    np.testing.assert_array_equal(life.info["enforced"], falls)
    np.testing.assert_array_equal(life.info["asked"], 0)
    np.testing.assert_array_equal(life.done, over)
    np.testing.assert_array_equal(life.info["budget"], np.where(over, 0.0, budget - cost * falls))
    np.testing.assert_array_equal(life.obs[:, 1], life.info["budget"] / budget)
    np.testing.assert_array_equal(life.obs[:, 0], np.where(over, 3, time % 4))
    np.testing.assert_array_equal(life.reward[1:], ((time % 4 == 3) & ~over)[1:])
    np.testing.assert_array_equal(life.metrics["success"], life.reward)


@pytest.mark.parametrize(("budget", "cost", "last"), [(6.3, 0.7, 9), (2.7, 0.9, 3), (9000.0, 0.9, 10_000)])
def test_a_budget_that_divides_exactly_ends_exactly_then_in_float32_too(budget, cost, last):
    env = HelpBudget(Chain(), budget=budget, help_cost=cost)
    late = lived(env, np.tile(HELP, (3, 1)), born(env, 0, asked=last - 2))
    assert late.done.tolist() == [0, 0, 1, 1]


def known_quality(chain, budget, help_cost, enforced_cost, absorbed):
    """Values [cliff, budget + 1, 3] of all actions in the augmented MDP, written down from its definition."""
    quality = np.zeros((chain.cliff, budget + 1, 3))
    for _, place, left, action in itertools.product(range(200), range(chain.cliff), range(1, budget + 1), range(3)):
        after = [max(place - 1, 0), place + 1, chain.start][action]
        cost = [0, 0, help_cost][action]
        if after == chain.cliff:
            after, cost = chain.start, enforced_cost
        reward = -abs(after - chain.goal) if chain.reward_type == "dense" else float(after == chain.goal)
        if cost > 0 and left - cost <= 0:
            quality[place, left, action] = absorbed / (1 - DISCOUNT)
        else:
            quality[place, left, action] = reward + DISCOUNT * quality[after, left - cost].max()
    return quality


def learnt_quality(env):
    """The same by value iteration over the transitions that `env` itself makes from every place, budget and action."""
    chain, budget = env.task, int(env.budget)
    places, lefts, moves = (part.ravel() for part in np.meshgrid(range(chain.cliff), range(1, budget + 1), range(3)))
    actions = jnp.stack([LEFT, RIGHT, HELP])[moves]
    kind = "asked" if env.help_cost == 1 else "enforced"
    after = jax.jit(jax.vmap(lambda p, k, a: env.step(born(env, p, **{kind: budget - k}), a)))(places, lefts, actions)
    following, rest = np.rint(after.obs[:, 0]).astype(int), np.rint(after.info["budget"]).astype(int)
    quality = np.zeros((chain.cliff, budget + 1, 3))
    for _ in range(400):
        value = quality.max(axis=-1)
        value[:, 0] = env.absorbed_reward / (1 - DISCOUNT)
        quality[places, lefts, moves] = np.asarray(after.reward) + DISCOUNT * value[following, rest]
    return quality


PROBLEMS = [
    (Chain(cliff=6, start=0, goal=1), (1, 2), 0.0),
    (Chain(cliff=6, start=4, goal=5), (2, 1), 0.0),
    (Chain(cliff=5, start=1, goal=4, reward_type="dense"), (1, 1), -10.0),
]


@pytest.mark.parametrize(("chain", "costs", "absorbed"), PROBLEMS)
def test_value_iteration_over_the_transform_gives_the_augmented_mdps_values(chain, costs, absorbed):
    env = HelpBudget(chain, 4, *map(float, costs), absorbed_reward=absorbed)
    expected = known_quality(chain, 4, *costs, absorbed)
    np.testing.assert_allclose(learnt_quality(env)[:, 1:], expected[:, 1:], rtol=1e-5, atol=1e-5)


def test_help_pays_far_from_the_goal_while_it_is_not_the_last_and_nowhere_else():
    left, help_ = 0, 2
    best = learnt_quality(HelpBudget(Chain(cliff=8, start=0, goal=1), 3)).argmax(axis=-1)
    assert best[6].tolist()[1:] == [left, help_, help_]
    assert best[2].tolist()[1:] == [left, left, left]


def test_help_moves_nobody_and_costs_its_own_price_even_beside_the_cliff():
    env = HelpBudget(Chain(start=1), budget=5.0, help_cost=0.5, enforced_cost=2.0)
    life = lived(env, [HELP, RIGHT, RIGHT, HELP, RIGHT, RIGHT, RIGHT])
    np.testing.assert_array_equal(life.obs[:, 0], [1, 1, 2, 3, 1, 2, 3, 1])
    np.testing.assert_array_equal(life.info["budget"], [5, 4.5, 4.5, 4.5, 4, 4, 4, 2])
    assert (life.info["asked"][-1], life.info["enforced"][-1]) == (2, 1)
    for goals in (life.obs[:, 2:], life.info["goal"], life.data.info["goal"]):
        np.testing.assert_array_equal(goals, 3.0)


@pytest.mark.parametrize(("above", "asks"), [(0.98, [0, 0, 1]), (-1.0, [0, 1, 1])])
def test_only_a_last_component_above_the_threshold_asks(above, asks):
    env = HelpBudget(Chain(), budget=9.0, help_above=above)
    actions = jnp.array([[1.0, -1.0], [1.0, 0.98], [1.0, 5.0]])
    assert [env.step(born(env), action).info["asked"] for action in actions] == asks


def test_an_intervention_starts_from_rho_drawn_anew_each_time():
    env = HelpBudget(make("tabletop_organization", wide=True), budget=9.0)
    step, ask = jax.jit(env.step), jnp.array([0, 0, 0, 1.0])
    first, same, other = (step(env.reset(jax.random.key(seed)), ask) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.obs, same.obs)
    assert len({float(state.obs[0]) for state in (first, other, step(first, ask))}) == 3


def test_an_intervention_from_outside_costs_nothing_and_forgives_nothing():
    env = HelpBudget(Chain(start=1), budget=5.0)
    before = jax.tree.map(lambda leaf: leaf[-1], lived(env, [HELP, RIGHT]))
    after = env.intervene(jax.random.key(3), before)
    assert described(after) == described(before)
    assert (after.obs[0], before.obs[0]) == (1, 2)
    assert (after.info["budget"], after.info["asked"], after.done) == (4, 1, 0)
    assert after.obs[1] == before.obs[1] == np.float32(0.8)
    ended = jax.tree.map(lambda leaf: leaf[-1], lived(env, np.tile(HELP, (5, 1))))
    assert ended.done == 1
    assert_same(env.intervene(jax.random.key(3), ended), ended)


def test_the_end_is_for_ever_and_earns_what_it_was_said_to():
    env = HelpBudget(Chain(reward_type="dense"), budget=1.0, absorbed_reward=-7.0)
    life = lived(env, [RIGHT, HELP, LEFT, HELP, RIGHT])
    np.testing.assert_array_equal(life.reward[1:], [-2, -7, -7, -7, -7])
    first, *later = (jax.tree.map(lambda leaf, row=row: leaf[row], life) for row in (2, 3, 4, 5))
    for other in later:
        assert_same(first, other)
    assert first.obs.tolist() == [1, 0, 3]
    assert env.goal_reward(first, jnp.zeros(1)) == env.reward(first.obs) == -7
    assert not HelpBudget(Chain(goal=1), budget=1.0).success(jnp.array([1.0, 0.0, 1.0]))


def test_a_fault_is_an_intervention_and_leaves_nothing_broken_behind():
    env = HelpBudget(Chain(fragile=True), budget=2.0)
    life = lived(env, [LEFT, RIGHT, LEFT, LEFT, LEFT])
    np.testing.assert_array_equal(life.info["enforced"], [0, 1, 1, 1, 2, 2])
    np.testing.assert_array_equal(life.done, [0, 0, 0, 0, 1, 1])
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(life))
    assert not jax.vmap(env.fault)(life).any()
    assert env.task.fault(env.task.step(env.task.reset(jax.random.key(0)), jnp.array([-1.0])))


CONTRACT = {"chain": Chain(), "peg": make("sawyer_peg", physics="c", reward_type="dense")}


@pytest.mark.parametrize("name", CONTRACT)
def test_it_keeps_the_contract_of_an_env_and_moves_like_its_task(name):
    env, lanes, steps = HelpBudget(CONTRACT[name], 2.0), 3, 3
    keys = jax.random.split(jax.random.key(0), lanes)
    actions = jax.random.uniform(jax.random.key(1), (steps, lanes, env.action_size), minval=-1, maxval=1)
    actions = actions.at[:, 1, -1].set(1.0)
    first = state = jax.jit(jax.vmap(env.reset))(keys)
    alone = [jax.tree.map(lambda leaf, i=i: leaf[i], state) for i in range(lanes)]
    inner = [single.data for single in alone]
    both = jax.jit(lambda state, inner, a: (env.step(state, a), env.task.step(inner, a[:-1])))
    step = jax.jit(jax.vmap(env.step))
    for action in actions:
        state = step(state, action)
        pairs = [both(*each) for each in zip(alone, inner, action, strict=True)]
        alone, inner = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    assert described(state) == described(first)
    assert described(alone[0]) == described(jax.eval_shape(env.intervene, keys[0], alone[0]))
    assert_same(state, jax.tree.map(lambda *leaves: jnp.stack(leaves), *alone), rtol=1e-6, atol=1e-6)
    assert state.done.tolist() == [0, 1, 0]
    for lane in (0, 2):
        assert_same((alone[lane].data, alone[lane].reward), (inner[lane], inner[lane].reward))
        np.testing.assert_array_equal(env.task_obs(alone[lane].obs), inner[lane].obs)
    goal = inner[2].obs[: env.goal_size]
    assert env.goal_reward(alone[2], goal) == env.task.goal_reward(inner[2], goal)
    flight = jax.eval_shape(env.launch, alone[0], actions[0, 0])
    own = jax.eval_shape(env.task.launch, inner[0], actions[0, 0, :-1])
    assert jax.tree.map(lambda leaf: leaf.dtype, flight) == (bool, jax.tree.map(lambda leaf: leaf.dtype, own))
    assert hash(env) == hash(dataclasses.replace(env)) != hash(dataclasses.replace(env, budget=3.0))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"budget": 0.0}, "budget must be above 0"),
        ({"budget": np.inf}, "and finite"),
        ({"help_cost": -1.0}, "help_cost must be at least 0"),
        ({"enforced_cost": np.nan}, "enforced_cost must be at least 0"),
        ({"help_above": 1.0}, r"help_above must lie in \[-1, 1\)"),
        ({"absorbed_reward": -1.0}, "absorbed_reward must be 0 with a sparse reward"),
        ({"task": Chain(reward_type="dense"), "absorbed_reward": np.nan}, "absorbed_reward must be finite"),
        ({"task": HelpBudget(Chain(), 1.0)}, "without a budget of its own"),
    ],
)
def test_what_makes_no_sense_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        HelpBudget(**{"task": Chain(), "budget": 1.0, **options})
    with pytest.raises(ValueError, match=r"takes \(2,\)"):
        HelpBudget(Chain(), 1.0).step(born(HelpBudget(Chain(), 1.0)), jnp.zeros(1))


def test_a_life_that_ends_in_the_loop_learns_and_stores_no_more_while_the_other_goes_on():
    env = HelpBudget(Chain(), budget=100.0, help_above=-1.0)
    problem = Problem(env, Protocol(train_horizon=7, eval_horizon=5))
    method = tiny_method("naive")
    lives = newborn(problem, method, [0, 1], steps=20)
    asked = jnp.array([95, 0])
    info = {**lives.lanes.world.info, "asked": asked, "budget": 100.0 - asked.astype(jnp.float32)}
    world = lives.lanes.world.replace(info=info, obs=lives.lanes.world.obs.at[:, 1].set(info["budget"] / 100.0))
    lives = lives.replace(lanes=lives.lanes.replace(world=world))
    onward = jax.jit(lambda lives: autonomy.run(problem, method, lives, 5))
    before = onward(lives)
    assert before.lanes.world.done.tolist() == [1, 0]
    assert before.replay.counts[:, 0].tolist() == [5, 5]
    after = onward(before)
    ended, living = ([jax.tree.map(lambda leaf, n=n: leaf[n], x.lanes) for x in (before, after)] for n in (0, 1))
    assert_same(*((lane.agent, lane.method_state, lane.world.data.data, lane.world.info["budget"]) for lane in ended))
    assert ended[1].world.done == 1
    assert ended[1].counters.window_reward == ended[0].counters.window_reward
    assert after.replay.counts[:, 0].tolist() == [5, 10]
    for one, other in zip(*(jax.tree.leaves(lane.agent.actor) for lane in living), strict=True):
        assert (plain(one) != plain(other)).any()
    assert living[1].world.info["asked"] == 10
