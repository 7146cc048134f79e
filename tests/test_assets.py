"""Tests of the shipped files: demonstrations that the demos command reproduces, and the paper's tables."""

import dataclasses

import jax
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.demos import scripted
from earl_jax.envs import make


def test_tabletop_ships_twelve_demonstrations_per_direction_and_three_per_goal(env):
    for direction in assets.DIRECTIONS:
        shipped = assets.demos(env.name, direction)
        assert shipped.ends.sum() == 12
        np.testing.assert_array_equal(shipped.rewards > 0, shipped.ends)
        lengths = np.diff(np.flatnonzero(np.append(True, shipped.ends)))
        assert lengths.min() >= 80
        assert lengths.max() <= 130
    forward = assets.demos(env.name, "forward")
    for goal in env.goal_states:
        assert (forward.goals[forward.ends] == goal).all(axis=1).sum() == 3
    backward = assets.demos(env.name, "backward")
    assert (backward.goals == env.initial_states[0]).all()


def test_demos_command_reproduces_the_shipped_file(env):
    recorded = scripted.make(env, seed=0)
    for direction in assets.DIRECTIONS:
        shipped = assets.demos(env.name, direction)
        for name, value in recorded[direction]._asdict().items():
            np.testing.assert_allclose(value, getattr(shipped, name), atol=1e-5, err_msg=name)
    actions, other = recorded["forward"].actions, scripted.make(env, seed=1)["forward"].actions
    assert len(other) != len(actions) or np.abs(other - actions).max() > 0.01


def test_dhand_grasps_can_be_recorded_and_used(tmp_path):
    env = make("dhand_lightbulb", engine="c")
    assert not env.has_demos
    start = env.reset(jax.random.key(0))
    rows, last = scripted.record(env, start, np.random.default_rng(0), steps=120)
    assert bool(env.success(last.obs))
    recorded = scripted.stacked(rows)
    assert np.flatnonzero(recorded.ends).tolist() == [119]
    assert recorded.rewards[-20:].all(), "the hand must hold the bulb until the end"
    scripted.save({"forward": recorded}, tmp_path / "grasp.npz")
    with_demos = dataclasses.replace(env, demo_file=str(tmp_path / "grasp.npz"))
    assert with_demos.demo_directions == ("forward",)
    np.testing.assert_array_equal(with_demos.demos("forward").actions, recorded.actions)
    with pytest.raises(RuntimeError, match="missed"):
        scripted.record(env, start, np.random.default_rng(0), steps=5)


def test_shipped_arrays_are_read_only(env):
    with pytest.raises(ValueError, match="read-only"):
        assets.demos(env.name, "forward").states[0] = 0


def test_missing_files_and_directions_are_refused_with_the_choices():
    with pytest.raises(ValueError, match="choose from forward, backward"):
        assets.demos("tabletop_organization", "sideways")
    with pytest.raises(ValueError, match=r"no demos for 'cheetah'.*tabletop_organization"):
        assets.demos("cheetah", "forward")
    with pytest.raises(ValueError, match=r"no mjcf for 'cheetah'"):
        assets.mjcf("cheetah")


def test_published_tables_contain_the_numbers_of_the_paper():
    first = {(row["env"], row["algo"]): row for row in assets.published("table1")}
    assert len(first) == 27
    assert first["tabletop_organization", "vaprl"]["mean"] == "0.98"
    assert first["minitaur_pen", "oracle"]["stderr"] == "3.40"
    assert len(assets.published("table2")) == 21
    assert assets.published_row("table1", env="sawyer_door", algo="r3l")["mean"] == "0.54"
    assert assets.published_row("steps", env="sawyer_door")["low"] == "4000000"
    assert assets.published_row("table1", env="sawyer_door", algo="nobody") == {}
