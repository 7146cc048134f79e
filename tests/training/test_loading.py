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


def test_policies_need_no_checkpoint(trained, folder):
    result = trained[1]
    shutil.rmtree(folder.checkpoints)
    expected = [result.policy(lane)(jnp.full(result.env.obs_size, 0.3)) for lane in range(2)]
    np.testing.assert_array_equal(actions_of(folder), expected)
    assert evaluate(folder.path, episodes=2)["deployed/success"].shape == (2,)


def test_the_newer_of_policies_and_checkpoint_is_taken(trained, folder):
    expected = actions_of(folder)
    folder.policies.unlink()
    np.testing.assert_array_equal(actions_of(folder), expected)
    actor = trained[1].policy(0).actor
    zeros = jax.tree.map(lambda leaf: np.zeros((2, *leaf.shape), leaf.dtype), actor)
    for step, zero in [(119, False), (120, True)]:
        policies.save_policies(folder.policies, zeros, step=step, seeds=[3, 7], obs_size=12, action_size=3)
        assert np.all(np.asarray(actions_of(folder)) == 0) == zero


def test_a_folder_without_both_says_how_to_go_on(folder):
    folder.policies.unlink()
    shutil.rmtree(folder.checkpoints)
    with pytest.raises(ValueError, match="has no checkpoint yet; continue the run with"):
        load_policies(folder)


def test_maps_of_visits_need_no_checkpoint(trained, folder):
    env, visits = load_visits(folder)
    np.testing.assert_array_equal(visits, load_lanes(folder)[2].visits)
    assert visits.sum(axis=(1, 2)).tolist() == [120, 120]
    assert env == trained[1].env
    shutil.rmtree(folder.checkpoints)
    np.testing.assert_array_equal(load_visits(folder)[1], visits)


def test_the_maps_of_a_newer_checkpoint_or_beside_an_older_file_are_those_of_the_checkpoint(trained, folder):
    visits, actor = load_visits(folder)[1], trained[1].policy(0).actor
    actors = jax.tree.map(lambda leaf: np.zeros((2, *leaf.shape), leaf.dtype), actor)
    others = {"seeds": [3, 7], "obs_size": 12, "action_size": 3}
    policies.save_policies(folder.policies, actors, step=80, visits=visits + 1, **others)
    np.testing.assert_array_equal(load_visits(folder)[1], visits)
    policies.save_policies(folder.policies, actors, step=120, **others)
    np.testing.assert_array_equal(load_visits(folder)[1], visits)
    shutil.rmtree(folder.checkpoints)
    with pytest.raises(ValueError, match=r"policies\.npz has no map of visits"):
        load_visits(folder)
    folder.policies.unlink()
    with pytest.raises(ValueError, match="has no checkpoint yet"):
        load_visits(folder)
