"""Wide starts: where they lie, that they are no success yet, and which tasks have them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax import assets
from earl_jax.envs import list_envs, make, start_of
from earl_jax.envs.sawyer import door
from earl_jax.protocol import Deployment

KEYS = jax.random.split(jax.random.key(0), 2000)
SPARSE = ["sawyer_door", "sawyer_peg", "tabletop_organization"]


@pytest.fixture(scope="module")
def draws():
    """The observations [2000, o] of wide starts of each sparse task."""
    return {name: np.asarray(jax.jit(jax.vmap(make(name).reset_wide))(KEYS).obs) for name in SPARSE}


def test_sparse_tasks_of_the_paper_have_wide_starts_and_dense_ones_have_none():
    assert [name for name in list_envs() if make(name).reset_wide] == SPARSE
    assert all(make(name, reward_type="dense").reset_wide is None for name in SPARSE)
    with pytest.raises(ValueError, match="franka_kitchen has no wide starts"):
        start_of(make("franka_kitchen"), "wide")


@pytest.mark.parametrize("name", SPARSE)
def test_wide_starts_have_the_layout_of_ordinary_ones(name):
    env = make(name)
    ordinary, wide = (jax.eval_shape(start, KEYS[0]) for start in (env.reset, env.reset_wide))
    assert jax.tree.map(lambda a: (a.shape, a.dtype, a.weak_type), ordinary) == jax.tree.map(
        lambda a: (a.shape, a.dtype, a.weak_type), wide
    )


@pytest.mark.parametrize("name", SPARSE)
def test_hardly_a_wide_start_is_a_success(draws, name):
    env = make(name)
    assert np.asarray(env.success(jnp.asarray(draws[name]))).mean() < 0.002


def test_half_of_the_starts_of_both_arms_lie_off_the_demonstrations(draws):
    for name in ("sawyer_door", "sawyer_peg"):
        demos = assets.demos(name, "forward")
        first = demos.states[np.append(True, demos.ends[:-1])]
        low, high = first[:, 4:7].min(axis=0) - 0.02, first[:, 4:7].max(axis=0) + 0.02
        objects = draws[name][:, 4:7]
        far = ((objects < low) | (objects > high)).any(axis=1)
        assert 0.35 < far.mean() < 0.7, name


def test_the_door_is_anywhere_with_the_arm_clear_of_it(draws):
    angles = np.asarray(jax.vmap(make("sawyer_door").joints_at)(draws["sawyer_door"][:, 4:7]))[:, 0]
    assert angles.min() < -1.3
    assert -0.3 < angles.max() <= -door.NOISE + 1e-4
    hands = np.unique(draws["sawyer_door"][:, :3].round(4), axis=0)
    assert len(hands) == 17, "the ordinary pose and sixteen others"
    away, above = np.linalg.norm(hands[:, :2] - door.HINGE, axis=1), hands[:, 2]
    assert ((away > 0.45) | (hands[:, 0] < -0.17) | (above > 0.3)).all()


def test_arm_poses_of_the_door_are_at_rest():
    env = make("sawyer_door", engine="c")
    starts = jax.vmap(env.reset_wide)(KEYS[:24])
    still = jnp.array([0.0, 0.0, 0.0, -1.0])
    moved = jax.jit(jax.vmap(lambda state: env.step(state, still)))(starts)
    resting = np.abs(np.asarray(starts.data.qvel)).max(axis=1) == 0
    assert 6 <= resting.sum() <= 18
    np.testing.assert_allclose(moved.obs[resting, :7], starts.obs[resting, :7], atol=1e-4)


def test_a_task_with_help_has_the_wide_starts_of_its_task():
    env = Deployment(budget=10.0).wrap(make("tabletop_organization"))
    state = env.reset_wide(jax.random.key(0))
    assert state.obs.shape == (env.obs_size,)
    assert float(state.info["budget"]) == 10.0
