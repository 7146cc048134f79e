"""Tests of the shipped files: demonstrations that the demos command reproduces."""

import dataclasses
import os

import jax
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.algos.goals import goal_table
from earl_jax.envs import make
from earl_jax.envs.demos import scripted

COUNTS = {"tabletop_organization": 12, "sawyer_door": 5, "sawyer_peg": 10}
"""The paper's number of demonstrations of each task that has some, in each direction."""


@pytest.mark.parametrize("direction", assets.DIRECTIONS)
@pytest.mark.parametrize("name", COUNTS)
def test_shipped_demonstrations_end_in_success(name, direction):
    env, demos = make(name), assets.demos(name, direction)
    assert demos.ends.sum() == COUNTS[name]
    np.testing.assert_array_equal(demos.rewards > 0, demos.ends)
    success = np.asarray(jax.jit(env.success)(np.hstack([demos.next_states, demos.goals])))
    np.testing.assert_array_equal(success, demos.ends)
    targets = env.goal_states if direction == "forward" else env.initial_states
    assert all((np.abs(targets - goal).max(axis=1) < 1e-6).any() for goal in demos.goals)
    with pytest.raises(ValueError, match="read-only"):
        demos.states[0] = 0


@pytest.mark.parametrize("name", ["tabletop_organization", "sawyer_door"])
def test_a_variant_of_a_task_with_a_name_of_its_own_keeps_the_files_of_the_task(name):
    """The door's had no model, and the table's no demonstrations, without a word."""
    task = make(name)
    variant = type("Variant", (type(task),), {"name": "variant"})()
    assert (variant.demonstrations.task, variant.demonstrations.directions) == (name, task.demonstrations.directions)
    assert variant.view.model == task.view.model
    start, own = (jax.jit(env.reset)(jax.random.key(0)) for env in (task, variant))
    np.testing.assert_array_equal(start.obs, own.obs)


@pytest.mark.parametrize("name", COUNTS)
def test_the_demos_command_reproduces_the_shipped_file(name):
    """On the arms, rounding grows with contacts: the first half of the first demonstration is compared."""
    for direction, demos in scripted.make(make(name)).items():
        shipped, kinematic = assets.demos(name, direction), name == "tabletop_organization"
        assert demos.ends.sum() == shipped.ends.sum()
        rows = slice(None if kinematic else np.flatnonzero(shipped.ends)[0] // 2)
        for field, value in demos._asdict().items():
            expected = getattr(shipped, field)[rows]
            np.testing.assert_allclose(value[rows], expected, atol=1e-5 if kinematic else 1e-3, err_msg=field)


def test_another_seed_makes_other_demonstrations(env):
    actions = scripted.make(env, seed=1)["forward"].actions
    shipped = assets.demos(env.name, "forward").actions
    assert len(actions) != len(shipped) or np.abs(actions - shipped).max() > 0.01


def test_dhand_grasps_can_be_recorded_and_used(tmp_path):
    env = make("dhand_lightbulb")
    assert not env.demonstrations.recorded
    start = jax.jit(env.reset)(jax.random.key(0))
    rows, last = scripted.record(env, start, np.random.default_rng(0), steps=120)
    assert jax.jit(env.success)(last.obs)
    recorded = scripted.stacked(rows)
    assert np.flatnonzero(recorded.ends).tolist() == [119]
    assert recorded.rewards[-20:].all(), "the hand must hold the bulb until the end"
    scripted.save({"forward": recorded}, tmp_path / "grasp.npz")
    with_demos = dataclasses.replace(env, demo_file=str(tmp_path / "grasp.npz"))
    assert with_demos.demonstrations.directions == ("forward",)
    np.testing.assert_array_equal(with_demos.demonstrations.load("forward").actions, recorded.actions)
    with pytest.raises(ValueError, match=r"another task or variant .*: its forward states have 32 numbers, not 35"):
        dataclasses.replace(with_demos, variant="paper").demonstrations.load("forward")
    with pytest.raises(ValueError, match=r"dhand_lightbulb: .* script missed the goal \[.*\] in 5 steps"):
        scripted.record(env, start, np.random.default_rng(0), steps=5)


def test_a_demo_file_that_changes_within_a_process_is_refused(tmp_path):
    """The first content used to be taken, silently: compiled programs have its goals."""
    shipped, file = assets.demos("tabletop_organization", "forward"), tmp_path / "mine.npz"
    scripted.save({"forward": shipped}, file)
    np.testing.assert_array_equal(assets.demos(str(file), "forward").actions, shipped.actions)
    os.utime(file, (0, 0))
    with pytest.raises(ValueError, match="has changed since this process read it"):
        assets.demos(str(file), "forward")


def test_a_caller_that_changes_published_numbers_changes_its_own_copy_alone():
    """`compare` and `preset` read the changed numbers later in the same process."""
    rows = assets.published("steps")
    rows[0]["env"] = "changed"
    assert assets.published_row("steps", env="changed") == {}
    arrays = [*assets.released_runs("tabletop_organization", "naive").values(), goal_table(make("sawyer_door")).table]
    assert not any(array.flags.writeable for array in arrays)


def test_missing_files_and_directions_are_refused_with_the_choices():
    with pytest.raises(ValueError, match="choose from forward, backward"):
        assets.demos("tabletop_organization", "sideways")
    with pytest.raises(ValueError, match=r"no demos for 'cheetah'.*tabletop_organization"):
        assets.demos("cheetah", "forward")
    with pytest.raises(ValueError, match=r"no mjcf for 'cheetah'.*tabletop_organization"):
        assets.mjcf("cheetah")
    with pytest.raises(ValueError, match=r"no mjcf for '/gone/cheetah.xml'; there is no such file$"):
        assets.mjcf("/gone/cheetah.xml")
    with pytest.raises(ValueError, match=r"no starts for 'fish_swim'; choose from cheetah_run"):
        assets.starts("fish_swim")
