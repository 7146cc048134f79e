"""What ships: demonstrations that their command reproduces, and the paper's tables."""

import dataclasses

import jax
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.demos import scripted as demos
from earl_jax.envs import make


def test_twelve_demonstrations_a_direction_three_a_goal(env):
    for direction in assets.DIRECTIONS:
        found = assets.demos(env.name, direction)
        assert found.ends.sum() == 12
        np.testing.assert_array_equal(found.rewards > 0, found.ends)
        lengths = np.diff(np.flatnonzero(np.append(True, found.ends)))
        assert lengths.min() >= 80
        assert lengths.max() <= 130
    forward = assets.demos(env.name, "forward")
    for goal in env.goal_states:
        assert (forward.goals[forward.ends] == goal).all(axis=1).sum() == 3
    backward = assets.demos(env.name, "backward")
    assert (backward.goals == env.initial_states[0]).all()


def test_the_command_reproduces_the_shipped_file(env):
    made = demos.make(env, seed=0)
    for direction in assets.DIRECTIONS:
        shipped = assets.demos(env.name, direction)
        for name, value in made[direction]._asdict().items():
            np.testing.assert_allclose(value, getattr(shipped, name), atol=1e-5, err_msg=name)
    other = demos.make(env, seed=1)["forward"].actions
    assert len(other) != len(made["forward"].actions) or np.abs(other - made["forward"].actions).max() > 0.01


def test_a_grasp_is_demonstrated_on_demand_though_none_ships(tmp_path):
    grasp = make("dhand_lightbulb", physics="c")
    assert not grasp.has_demos
    start = grasp.reset(jax.random.key(0))
    rows, ended = demos.record(grasp, start, np.random.default_rng(0), steps=120)
    assert bool(grasp.success(ended.obs))
    found = demos.stacked(rows)
    assert np.flatnonzero(found.ends).tolist() == [119]
    assert found.rewards[-20:].all(), "it goes on holding"
    demos.save({"forward": found}, tmp_path / "grasp.npz")
    given = dataclasses.replace(grasp, demo_file=str(tmp_path / "grasp.npz"))
    assert given.demo_directions == ("forward",)
    np.testing.assert_array_equal(given.demos("forward").actions, found.actions)
    with pytest.raises(RuntimeError, match="missed"):
        demos.record(grasp, start, np.random.default_rng(0), steps=5)


def test_shipped_arrays_cannot_be_written_to(env):
    with pytest.raises(ValueError, match="read-only"):
        assets.demos(env.name, "forward").states[0] = 0


def test_what_is_not_there_names_what_is():
    with pytest.raises(ValueError, match="choose from forward, backward"):
        assets.demos("tabletop_organization", "sideways")
    with pytest.raises(ValueError, match=r"no demos for 'cheetah'.*tabletop_organization"):
        assets.demos("cheetah", "forward")
    with pytest.raises(ValueError, match=r"no mjcf for 'cheetah'"):
        assets.mjcf("cheetah")


def test_the_published_tables():
    first = {(row["env"], row["algo"]): row for row in assets.published("table1")}
    assert len(first) == 27
    assert first["tabletop_organization", "vaprl"]["mean"] == "0.98"
    assert first["minitaur_pen", "oracle"]["stderr"] == "3.40"
    assert len(assets.published("table2")) == 21
    assert assets.published_row("table1", env="sawyer_door", algo="r3l")["mean"] == "0.54"
    assert assets.published_row("steps", env="sawyer_door")["low"] == "4000000"
    assert assets.published_row("table1", env="sawyer_door", algo="nobody") == {}
