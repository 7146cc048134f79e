"""The first train state: demonstrations in the replay, and a start state after them."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from earl_jax import assets
from earl_jax.algos import Method, Phase
from earl_jax.algos.learner import replay
from earl_jax.algos.method import BACKWARD, FORWARD
from earl_jax.envs import make
from earl_jax.errors import InputError
from earl_jax.training.init import LONGEST_SHARED, demo_rows, empty_replay, replay_steps
from earl_jax.training.runner import _init
from earl_jax.training.state import Problem, seed_keys
from tests.conftest import RUN_STEPS, make_train_state, take_lane, tiny_method


@pytest.mark.parametrize(("algo", "reward_type"), [("fbrl", "sparse"), ("vaprl", "sparse"), ("vaprl", "dense")])
def test_demonstrations_are_the_first_rows_and_are_sampled_unchanged(problem, algo, reward_type):
    env = make("tabletop_organization", reward_type=reward_type)
    problem = Problem(env, problem.protocol)
    state = make_train_state(problem, tiny_method(algo), [0, 1])
    keys, zeros = jax.random.split(jax.random.key(0), 2), jnp.zeros(2)
    batch = jax.jit(replay.sample, static_argnums=3)(state.replay, keys, zeros.astype(int), 3000, zeros)
    forward = assets.demos(env.name, "forward")
    sampled = jax.tree.map(np.asarray, take_lane(batch, 0))
    steps, known = np.hstack([sampled.state, sampled.action]), np.hstack([forward.states, forward.actions])
    matches = (steps[:, None] == known).all(axis=-1)
    is_forward = matches.any(axis=1)
    assert (is_forward.mean() < 0.9) == (algo == "vaprl")
    number = matches[is_forward].argmax(axis=1)
    np.testing.assert_array_equal(sampled.next_state[is_forward], forward.next_states[number])
    np.testing.assert_array_equal(problem.goals.table[sampled.flags.goal[is_forward]], forward.goals[number])
    if env.sparse:
        np.testing.assert_array_equal(sampled.reward[is_forward], forward.rewards[number])
    else:
        assert not sampled.flags.reached.any()
        obs = np.concatenate([sampled.next_state, problem.goals.table[sampled.flags.goal]], axis=-1)
        np.testing.assert_allclose(sampled.reward, env.reward(obs), rtol=1e-5)


def test_training_starts_at_rho_in_the_row_after_the_demonstrations(problem):
    state = make_train_state(problem, tiny_method("vaprl"), [0, 1])
    first = int(state.replay.row)
    assert first == len(problem.goals.candidates)
    np.testing.assert_array_equal(state.replay.state[first], np.tile(problem.env.initial_states, (2, 1)))
    assert int(state.step) == 0


def test_demonstrated_rows_have_the_order_of_the_goals_whatever_the_first_phase_samples(problem):
    class Backwards(Method):
        name = "backwards"
        phases = Phase((BACKWARD,)), Phase((FORWARD,))

    np.testing.assert_array_equal(demo_rows(problem, Backwards()).states, problem.goals.candidates)


def test_vaprl_lists_a_demonstrated_step_once_for_every_five_later_states(problem):
    """The release copies demonstrations for every later state; a copy weighs 1 / (N + 1) of a transition of one's own."""
    demos = demo_rows(problem, tiny_method("vaprl"))
    steps_left = problem.goals.ends[demos.rows] - demos.rows
    np.testing.assert_array_equal(demos.copies, np.maximum(1, np.rint(steps_left / 5)))
    assert empty_replay(problem, tiny_method("vaprl"), 1, 128).capacity == 128 + demos.copies.sum()


@pytest.mark.parametrize(
    ("steps", "kept", "length"),
    [
        (1, None, 1), (100, None, 128), (128, None, 128), (LONGEST_SHARED + 1, None, LONGEST_SHARED + 1),
        (100, 120, 120), (120, 120, 120), (121, 120, 121), (900, 120, 121),
    ],
)  # fmt: skip
def test_short_runs_and_those_that_evict_transitions_have_the_replay_of_others(problem, steps, kept, length):
    method = tiny_method("naive", replay_capacity=kept)
    assert replay_steps(method, steps) == replay_steps(method, length) == length
    replay = empty_replay(problem, method, 1, steps)
    assert replay.capacity >= min(steps, kept or steps) + len(demo_rows(problem, method).states)
    assert replay.evicts == (kept is not None and steps > kept)


DEMO_TASK = "tabletop_organization"
DIRECTIONS = {
    "naive": ("f",), "oracle": ("f",), "r3l": ("f", ""), "vaprl": ("fb",), "bc": ("fb",), "fbrl": ("f", "b"),
    "medal": ("f", "fb"),
}  # fmt: skip
"""The demonstrations of each controller: forward, backward or both."""


def fill(name, value):
    """Return the change that puts `value` into the fourth row of the array `name`."""
    return lambda arrays: arrays[name][3:4].fill(value)


CHANGES = [
    (lambda arrays: arrays.update({name: array[:0] for name, array in arrays.items()}), "fit together"),
    (lambda arrays: arrays.update(rewards=arrays["rewards"][1:]), "fit together: .*'rewards': .1240"),
    (lambda arrays: arrays.update(states=arrays["states"].ravel()), "fit together: {'states': .7446"),
    (lambda arrays: arrays.update(next_states=np.zeros((1241, 7))), "fit together"),
    (lambda arrays: arrays.pop("goals"), "is damaged: it lacks arrays"),
    (lambda arrays: arrays.clear(), "has no demonstrations: it lacks forward_states .*import-demos"),
    (lambda arrays: arrays["ends"].fill(False), "stops in the middle of an episode"),
    (lambda arrays: arrays["ends"][:-1].fill(False), "row 119 does not begin where row 118 arrives"),
    (fill("actions", 1.01), r"the actions have values outside \[-1, 1\]"),
    *[(fill(name, np.nan), f"the {name} have values that are not finite") for name in assets.Demos._fields[:-1]],
]
"""Changes of the arrays of a demo file, and what is said of it then."""


@pytest.mark.parametrize(
    ("task", "file", "message"),
    [
        (DEMO_TASK, "missing", r"no demos for 'missing'; choose from sawyer_door"),
        (DEMO_TASK, "missing.npz", r"no demos for 'missing.npz'; there is no such file"),
        (DEMO_TASK, "", r"no demos for ''"),
        (DEMO_TASK, "/dev/null", r"no demos for '/dev/null'; there is no such file"),
        ("sawyer_door", DEMO_TASK, f"{DEMO_TASK} is of another task or variant .* states have 6 numbers, not 7"),
        ("franka_kitchen", DEMO_TASK, "forward states have 6 numbers, not 23"),
        *[(DEMO_TASK, change, f"mine.npz.*{message}") for change, message in CHANGES],
    ],
)
def test_a_demo_file_that_cannot_be_used_is_refused_before_training(task, file, message, tmp_path):
    """A misspelt file used to train without demonstrations, and NaN to end a run as diverged."""
    if callable(file):
        arrays = {field: array.copy() for field, array in assets.demos(DEMO_TASK, "forward")._asdict().items()}
        file(arrays)
        file = str(tmp_path / "mine.npz")
        np.savez(file, **{f"forward_{field}": array for field, array in arrays.items()})
    for algo in ("fbrl", "medal"):
        with pytest.raises(InputError, match=message):
            earl_jax.train(make(task, demo_file=file), algo, seeds=2, steps=40, eval_every=40, out=tmp_path / "run")
        assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("all_demos", [False, True])
@pytest.mark.parametrize("algo", DIRECTIONS)
def test_a_controller_has_its_demonstrations_or_with_all_demos_those_of_both_directions(problem, algo, all_demos):
    forward, backward = (len(assets.demos(problem.env.name, name).states) for name in assets.DIRECTIONS)
    demos = demo_rows(problem, tiny_method(algo, all_demos=all_demos))
    for controller, own in enumerate(DIRECTIONS[algo]):
        directions = "fb" if own and all_demos else own
        is_backward = demos.goals[demos.controllers == controller] >= problem.goals.tasks
        expected = [forward * ("f" in directions), backward * ("b" in directions)]
        assert [int((~is_backward).sum()), int(is_backward.sum())] == expected


def test_two_phases_of_one_controller_list_its_demonstrations_once(problem):
    twice = type("Twice", (Method,), {"name": "twice", "phases": (Phase(), Phase(length=3))})()
    np.testing.assert_array_equal(demo_rows(problem, twice).rows, demo_rows(problem, Method()).rows)


def test_the_program_of_the_first_state_does_not_contain_the_replay(problem):
    method, rules = tiny_method("fbrl"), jax.tree.map(lambda rule: jnp.full(2, rule), problem.protocol.rules)
    capacity = empty_replay(problem, method, 1, RUN_STEPS).capacity
    program = _init.lower(problem, method, seed_keys([0, 1]), rules, RUN_STEPS, None).compile().as_text()
    assert f"f32[{capacity + 1},2," in program
    assert not re.search(rf"f32\[{capacity + 1},2,\S* constant\(", program)
