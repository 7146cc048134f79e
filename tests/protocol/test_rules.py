"""The rules of interventions and goals, on a chain with its goal at 3."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from earl_jax.protocol import Attempt, Protocol, Rules, advance_rules
from tests.envs.chain import Chain

GOAL = 3
NEVER = Rules(horizon=0, chance=0.0, goal_change=0)
TASK = Attempt(is_task=True, expires=False, ends_on_success=True, reset_at_end=False)
RESTART = {"timeout", "phase_ended", "task_restarts", "env_reset"}
"""What an intervention is."""
advance = jax.jit(advance_rules, static_argnums=1)


def step_end(state, attempt=TASK, rules=NEVER, step=1, env=None, key=0):
    """Return the names of the fields of `StepEnd` that are true for a step to `state`."""
    end = advance(rules, env or Chain(), state, attempt, jnp.asarray(step), jax.random.key(key))
    return {name for name, value in end._asdict().items() if bool(value)}


def state_at(position, env=None):
    return (env or Chain()).state_at(position, [float(GOAL)])


ENDS = {
    "goes on": (1, {}, set()),
    "reaches its goal": (GOAL, {}, {"reached", "phase_ended"}),
    "goes on at its goal": (GOAL, {"ends_on_success": False}, {"passed"}),
    "success resets": (GOAL, {"reset_at_end": True}, {"reached", "phase_ended", "env_reset"}),
    "times out": (1, {"expires": True}, {"timeout", "phase_ended"}),
    "time-out resets": (1, {"expires": True, "reset_at_end": True}, {"timeout", "phase_ended", "env_reset"}),
    "reaches its goal on its last step": (GOAL, {"expires": True}, {"reached", "phase_ended"}),
}


@pytest.mark.parametrize(("position", "changes", "expected"), ENDS.values(), ids=ENDS)
def test_an_attempt_ends_at_its_goal_or_at_its_limit(position, changes, expected):
    assert step_end(state_at(position), TASK._replace(**changes)) == expected


def test_a_dense_reward_and_a_state_after_the_absorbing_end_end_no_attempt():
    env = Chain(reward_type="dense")
    assert step_end(state_at(GOAL, env), env=env) == set()
    assert step_end(state_at(GOAL).replace(done=jnp.ones(()))) == set()


@pytest.mark.parametrize("position", [1, GOAL])
def test_a_fault_resets_the_lane_and_is_never_a_success(position):
    broken = state_at(position).replace(data=jnp.full(1, jnp.nan))
    assert step_end(broken) == {"fault", *RESTART}


@pytest.mark.parametrize("is_task", [True, False])
def test_an_intervention_comes_every_horizon_steps_and_restarts_the_task(is_task):
    rules, attempt = NEVER._replace(horizon=5), TASK._replace(is_task=is_task)
    for step in (4, 6):
        assert step_end(state_at(1), attempt, rules, step) == set()
    for step in (5, 10):
        assert step_end(state_at(1), attempt, rules, step) == RESTART
        ended = state_at(1).replace(done=jnp.ones(()))
        assert step_end(ended, attempt, rules, step) == RESTART - {"env_reset"}
    assert step_end(state_at(GOAL), attempt, rules, 5) == {"reached", "phase_ended", "task_restarts", "env_reset"}


def test_an_intervention_by_chance_depends_on_the_key_alone():
    rules = NEVER._replace(chance=0.25)
    ends = [step_end(state_at(1), rules=rules, key=key) for key in range(80)]
    assert ends == [step_end(state_at(1), rules=rules, step=2, key=key) for key in range(80)]
    assert set(map(frozenset, ends)) == {frozenset(), frozenset(RESTART)}
    keys = jax.random.split(jax.random.key(0), 4000)
    share = jax.jit(lambda rules: jax.vmap(rules.intervened, (None, 0))(1, keys).mean())
    assert [share(rules), share(NEVER._replace(chance=1.0))] == pytest.approx([0.25, 1.0], abs=0.02)


def test_a_goal_change_ends_an_attempt_at_the_task_and_not_a_return():
    rules, returning = NEVER._replace(goal_change=5), TASK._replace(is_task=False)
    assert step_end(state_at(1), TASK, rules, 4) == set()
    assert step_end(state_at(1), TASK, rules, 5) == {"goal_changes", "timeout", "phase_ended", "task_restarts"}
    assert step_end(state_at(1), TASK._replace(expires=True), rules, 5) == {"goal_changes", "timeout", "phase_ended"}
    assert step_end(state_at(GOAL), TASK, rules, 5) == {"goal_changes", "reached", "phase_ended"}
    assert step_end(state_at(1), returning, rules, 5) == {"goal_changes"}
    assert step_end(state_at(GOAL), returning, rules, 5) == {"goal_changes", "reached", "phase_ended"}


def test_a_protocol_refuses_invalid_numbers():
    for changes, message in (
        ({"eval_every": 0}, r"protocol: eval_every must lie in \[1, 2147483647\], not 0"),
        ({"train_horizon": -1}, r"train_horizon must lie in \[0, 2147483647\], not -1"),
        ({"intervention_chance": 1.5}, r"intervention_chance must lie in \[0, 1\], not 1.5"),
    ):
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(Protocol(10, 10), **changes)
