"""Compiled models: the kinematic task drawn by MuJoCo, and the inverse weights of the originals."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import physics
from earl_jax.envs import make
from earl_jax.envs.sawyer.door import SawyerDoor
from earl_jax.errors import InputError
from earl_jax.rendering.overlays import with_overlay
from tests.envs.programs import first_state, program


def test_mujoco_draws_gripper_and_mug_at_their_observed_positions(env):
    moved = program(env, "step")(first_state(env), jnp.array([1.0, -0.5, 0.0]))
    model, data = physics.load_model(env.name), physics.mujoco_data(env.name, moved.data)
    for body, part in (("gripper", slice(0, 2)), ("mug", slice(2, 4))):
        np.testing.assert_allclose(data.xpos[model.body(body).id][:2], moved.obs[part], atol=1e-6)
    assert (model.nu, data.ncon) == (0, 0)


@pytest.mark.parametrize("body", ["<body>", "<body><joint/></body>"])
def test_a_file_that_mujoco_cannot_compile_is_named(body, tmp_path):
    file = tmp_path / "mine.xml"
    file.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    with pytest.raises(InputError, match=rf"{file} is not a model that MuJoCo can compile: .*[Ll]ine.*1"):
        physics.load_model(str(file))


def test_a_file_that_changed_after_it_was_compiled_is_refused_instead_of_ignored(tmp_path):
    file = tmp_path / "mine.xml"
    file.write_text("<mujoco/>")
    task = type("Mine", (SawyerDoor,), {"model": str(file)})
    assert task().simulator.mujoco_model().nbody == 1
    file.write_text("<mujoco><worldbody><body/></worldbody></mujoco>")
    with pytest.raises(InputError, match=f"{file} has changed since this process read it"):
        task()


def test_coasters_are_drawn_at_the_goals_and_not_simulated(env):
    model = with_overlay(env.name)
    drawn = model.geom_pos[model.geom_bodyid == 0, :2]
    for place in (*env.goal_states[:, 2:4], env.initial_states[0, 2:4]):
        assert np.isclose(drawn, place, atol=1e-6).all(axis=1).any()
    assert physics.load_model(env.name).ngeom == 0


def test_a_lane_carries_the_integration_state_alone(env):
    data = first_state(env).data
    assert sum(leaf.size for leaf in jax.tree.leaves(data)) == 4 + 4 + 4 + 1


@pytest.mark.parametrize("name", ["sawyer_door", "sawyer_peg"])
def test_the_arm_is_as_heavy_as_the_original(name):
    """Inverse weights of the seven joints as the original compiles them; a visual geom with a mass would change them."""
    original = [0.287820, 3.924983, 40.165526, 15.700716, 125.917170, 139.201912, 691.249256]
    np.testing.assert_allclose(physics.load_model(name).dof_invweight0[:7], original, rtol=1e-4)


def test_the_compiled_model_has_the_weld_of_the_original():
    model = physics.load_model("sawyer_door")
    hand = model.body_invweight0[model.body("hand").id]
    np.testing.assert_allclose(hand, 6.1056272, rtol=1e-6)
    assert dataclasses.replace(make("sawyer_door"), substeps=4).simulator.mujoco_model().opt.timestep == 0.0125 / 4
    assert model.opt.timestep == 0.0025


@pytest.mark.parametrize(("name", "reference"), [("franka_kitchen", 0.002), ("dhand_lightbulb", 0.0025)])
def test_a_longer_time_step_keeps_the_stiffness_of_constraints_and_a_shorter_one_the_armature(name, reference):
    """The stiffness is 1 / (time constant * damping ratio)^2; MuJoCo raises time constants to two time steps."""
    original, longer = physics.load_model(name, reference), physics.load_model(name, 4 * reference)
    stiff = 0
    for field in ("eq_solref", "pair_solref", "jnt_solref"):
        before, after = getattr(original, field), getattr(longer, field)
        np.testing.assert_allclose(after.prod(axis=1), before.prod(axis=1), rtol=1e-12)
        assert (after[:, 0] >= 8 * reference - 1e-12).all()
        stiff += (before[:, 0] < 8 * reference).sum()
    assert stiff > 0
    np.testing.assert_array_equal(physics.load_model(name, reference / 2).dof_armature, original.dof_armature)
    gained = longer.dof_armature - original.dof_armature
    assert (gained[:7] > 0).all()
    np.testing.assert_array_equal(gained[23:], 0.0)
