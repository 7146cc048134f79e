"""Policies and maps of visits of a run folder: those of policies.npz or of a checkpoint, whichever is newer."""

import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.runs import policies
from earl_jax.runs.folder import RunFolder
from earl_jax.training import evaluate, load_lanes, load_policies, load_visits, select_seed
from tests.conftest import tiny_train


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "run"
    return path, tiny_train("fbrl", seeds=[3, 7], out=path, checkpoint_every=40)


@pytest.fixture
def folder(trained, tmp_path):
    shutil.copytree(trained[0], tmp_path / "run")
    return RunFolder.open(tmp_path / "run")


def actions_of(folder):
    _, policy = load_policies(folder)
    return [np.asarray(select_seed(policy, lane)(jnp.full(policy.obs_size, 0.3))) for lane in range(2)]


def test_policies_and_maps_of_visits_need_no_checkpoint(trained, folder):
    result = trained[1]
    env, visits = load_visits(folder)
    assert env == result.env
    np.testing.assert_array_equal(visits, load_lanes(folder)[2].visits)
    assert visits.sum(axis=(1, 2)).tolist() == [120, 120]
    shutil.rmtree(folder.checkpoints)
    np.testing.assert_array_equal(load_visits(folder)[1], visits)
    expected = [result.policy(lane)(jnp.full(result.env.observation_size, 0.3)) for lane in range(2)]
    np.testing.assert_array_equal(actions_of(folder), expected)
    assert evaluate(folder.path, episodes=2)["deployed/success"].shape == (2,)


def test_the_newer_of_policies_and_checkpoint_is_taken(trained, folder):
    expected, visits = actions_of(folder), load_visits(folder)[1]
    folder.policies.unlink()
    np.testing.assert_array_equal(actions_of(folder), expected)
    actor = trained[1].policy(0).actor
    zeros = jax.tree.map(lambda leaf: np.zeros((2, *leaf.shape), leaf.dtype), actor)
    for step, newer in [(119, False), (120, True)]:
        policies.save_policies(
            folder.policies, zeros, step=step, seeds=[3, 7], obs_size=12, action_size=3, visits=visits + 1
        )
        assert np.all(np.asarray(actions_of(folder)) == 0) == newer
        np.testing.assert_array_equal(load_visits(folder)[1], visits + newer)


def test_what_a_folder_lacks_is_named(trained, folder):
    visits, actor = load_visits(folder)[1], trained[1].policy(0).actor
    actors = jax.tree.map(lambda leaf: np.zeros((2, *leaf.shape), leaf.dtype), actor)
    policies.save_policies(folder.policies, actors, step=120, seeds=[3, 7], obs_size=12, action_size=3)
    np.testing.assert_array_equal(load_visits(folder)[1], visits, "those of the checkpoint")
    shutil.rmtree(folder.checkpoints)
    with pytest.raises(ValueError, match=r"policies\.npz has no map of visits"):
        load_visits(folder)
    folder.policies.unlink()
    for load in (load_visits, load_policies):
        with pytest.raises(ValueError, match="has no checkpoint yet; continue the run with"):
            load(folder)
