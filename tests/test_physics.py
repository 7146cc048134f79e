"""The kinematic task seen through MuJoCo: the same world in two pictures."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import physics


def placed(env):
    state = env.reset(jax.random.key(0))
    for action in ([1.0, 0.5, 0.0], [1.0, -0.2, 0.0]):
        state = env.step(state, jnp.array(action))
    return state


def test_mujoco_draws_gripper_and_mug_where_the_observation_has_them(env):
    state = placed(env)
    model, data = physics.load_model(env.name), physics.mujoco_data(env.name, state.data)
    for body, part in (("gripper", slice(0, 2)), ("mug", slice(2, 4))):
        np.testing.assert_allclose(data.xpos[model.body(body).id][:2], state.obs[part], atol=1e-6)
    assert model.nu == 0
    assert data.ncon == 0


def test_mjx_agrees_with_mujoco(env):
    state = placed(env)
    ours, theirs = physics.mjx_data(env.name, state.data), physics.mujoco_data(env.name, state.data)
    np.testing.assert_allclose(ours.xpos, theirs.xpos, atol=1e-6)
    np.testing.assert_allclose(ours.qpos, theirs.qpos, atol=1e-7)


def test_coasters_are_drawn_at_the_goals(env):
    model = physics.load_model(env.name)
    for colour, goal in zip("rgbk", env.goal_states, strict=True):
        np.testing.assert_allclose(model.geom(f"coaster_{colour}").pos[:2], goal[2:4])
    np.testing.assert_allclose(model.geom("start").pos[:2], env.initial_states[0, 2:4])


def test_the_integration_state_is_all_a_lane_carries(env):
    data = env.reset(jax.random.key(0)).data
    assert sum(leaf.size for leaf in jax.tree.leaves(data)) == 4 + 4 + 4 + 1


def test_an_unknown_model_names_the_choices():
    with pytest.raises(ValueError, match="tabletop_organization"):
        physics.load_model("table")
