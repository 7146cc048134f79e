"""What a run folder gives: its result, and policies and maps of visits of policies.npz or of a newer checkpoint."""

import shutil
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import earl_jax
from earl_jax.runs import policies
from earl_jax.runs.folder import RunFolder
from earl_jax.training import evaluate, load_lanes, load_policies, load_visits, loading, select_seed
from tests.conftest import tiny_train
from tests.report.run_files import change_config


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "run"
    return path, tiny_train("fbrl", seeds=[3, 7], out=path, checkpoint_every=40)


@pytest.fixture
def folder(trained, tmp_path):
    shutil.copytree(trained[0], tmp_path / "run")
    return RunFolder.open(tmp_path / "run")


def actions_of(folder):
    policy = load_policies(folder)
    return [np.asarray(select_seed(policy, lane)(jnp.full(policy.obs_size, 0.3))) for lane in range(2)]


def test_policies_and_maps_of_visits_need_no_checkpoint(trained, folder):
    env, visits = load_visits(folder)
    assert env == trained[1].env
    np.testing.assert_array_equal(visits, load_lanes(folder)[2].visits)
    assert visits.sum(axis=(1, 2)).tolist() == [120, 120]
    shutil.rmtree(folder.checkpoints)
    np.testing.assert_array_equal(load_visits(folder)[1], visits)
    assert evaluate(folder.path, episodes=2, pairs="balanced")["deployed/success"].shape == (2,)
    with pytest.raises(ValueError, match=r"need the task's own starts \(initial\), not wide ones"):
        evaluate(folder.path, episodes=2, starts="wide", pairs="balanced")


@pytest.mark.parametrize("wrong", [{"episodes": 0}, {"starts": "x"}, {"pairs": "x"}])
def test_evaluate_checks_its_arguments_before_it_reads_policies(folder, wrong):
    folder.policies.write_bytes(b"")
    shutil.rmtree(folder.checkpoints)
    with pytest.raises(ValueError, match=next(iter(wrong))):
        evaluate(folder.path, **wrong)


def test_a_run_is_read_from_its_folder_alone(trained):
    with pytest.raises(
        ValueError, match=r"a run is read from its folder, a path or Result\.folder, not from Result +task"
    ):
        evaluate(trained[1])
    for own in (trained[1].env, trained[1].policy(0)):
        with pytest.raises(ValueError, match=r"a policy of your own is evaluated by earl_jax\.protocol\.deployed"):
            evaluate(own, 10)


def save_zeros(trained, folder, step, visits=None):
    """Put policies of zeros and maps of `visits` into the place of policies.npz."""
    zeros = jax.tree.map(np.zeros_like, trained[1].policies.actor)
    policies.save_policies(folder.policies, zeros, step, [3, 7], obs_size=12, action_size=3, visits=visits)


def test_the_newer_of_policies_and_checkpoint_is_taken(trained, folder):
    expected, visits = actions_of(folder), load_visits(folder)[1]
    folder.policies.unlink()
    np.testing.assert_array_equal(actions_of(folder), expected)
    for step, newer in [(119, False), (120, True)]:
        save_zeros(trained, folder, step, visits + 1)
        assert np.all(np.asarray(actions_of(folder)) == 0) == newer
        np.testing.assert_array_equal(load_visits(folder)[1], visits + newer)


def test_what_a_folder_lacks_is_named(trained, folder):
    visits = load_visits(folder)[1]
    save_zeros(trained, folder, 120)
    np.testing.assert_array_equal(load_visits(folder)[1], visits, "those of the checkpoint")
    shutil.rmtree(folder.checkpoints)
    with pytest.raises(ValueError, match=r"policies\.npz has no map of visits"):
        load_visits(folder)
    folder.policies.unlink()
    for load in (load_visits, load_policies):
        with pytest.raises(ValueError, match=r"has no policies\.npz and no checkpoint"):
            load(folder)


@pytest.fixture
def bare(folder, monkeypatch):
    """The folder without its checkpoints, and the state of training without a trace."""
    shutil.rmtree(folder.checkpoints)
    monkeypatch.setattr(loading, "shapes_of", None)
    return folder


def test_a_folder_without_checkpoints_gives_the_result_of_its_training(trained, bare):
    result, loaded = trained[1], earl_jax.load(bare.path)
    assert (loaded.config.values, loaded.env, loaded.engine) == (result.config.values, result.env, result.engine)
    assert (loaded.seeds, loaded.step, loaded.finished, loaded.train_state) == ((3, 7), 120, True, None)
    np.testing.assert_array_equal(loaded.steps, result.steps)
    np.testing.assert_equal(loaded.metrics, result.metrics)
    np.testing.assert_equal(loaded.scores, result.scores)
    obs = jnp.full(12, 0.3)
    for lane, seed in enumerate(result.seeds):
        for policy in (loaded.policy(lane), loaded.policy(seed=seed), result.policy(seed=seed)):
            np.testing.assert_array_equal(policy(obs), result.policy(lane)(obs))
    np.testing.assert_allclose(jax.vmap(lambda one: one(obs))(loaded.policies)[1], loaded.policy(1)(obs), atol=1e-6)
    with pytest.raises(ValueError, match="no seed 1 in this run; choose from 3, 7"):
        loaded.policy(seed=1)


def test_policies_of_a_run_that_replaced_the_loaded_one_are_refused(bare):
    """They used to be returned, beside the seeds and metrics of the earlier run."""
    result = earl_jax.load(bare.path)
    assert earl_jax.load(bare.path).policies.obs_size == 12
    change_config(bare.path, id="other")
    with pytest.raises(ValueError, match="holds another run than when it was loaded; load it again"):
        result.policy(seed=3)


def test_a_run_of_classes_that_are_not_registered_here_can_be_read(trained, bare):
    change_config(bare.path, env="meadow", algo="patient")
    loaded = earl_jax.load(bare.path)
    np.testing.assert_equal(loaded.metrics, trained[1].metrics)
    np.testing.assert_array_equal(loaded.policy(1)(jnp.full(12, 0.3)), trained[1].policy(1)(jnp.full(12, 0.3)))
    assert "task: meadow" in repr(loaded)
    with pytest.raises(ValueError, match="unknown task 'meadow'"):
        _ = loaded.env
    change_config(bare.path, options={})
    with pytest.raises(ValueError, match=r"is not float32\[.*; unknown method 'patient'"):  # its defaults are not known
        _ = earl_jax.load(bare.path).policies
    change_config(bare.path, algo="naive", options={"learner": "own"}, imports=[{"file": "own.py", "sha256": "0" * 64}])
    with pytest.raises(ValueError, match=r"unknown learner 'own': this run was trained with own\.py"):
        _ = earl_jax.load(bare.path).policies
    change_config(bare.path, setting={"name": "deployment", "budget": 5.0})
    with pytest.raises(ValueError, match="unknown task 'meadow'"):
        _ = earl_jax.load(bare.path).policies


def test_a_run_before_its_first_evaluation_has_no_metrics(bare):
    bare.metrics.unlink()
    bare.policies.unlink()
    loaded = earl_jax.load(bare.path)
    assert (loaded.step, loaded.finished, loaded.metrics) == (0, False, {})
    assert "score" not in repr(loaded)
    with pytest.raises(ValueError, match=r"has no policies\.npz"):
        loaded.policy()


def test_the_frame_has_the_rows_of_the_table(bare, monkeypatch):
    loaded = earl_jax.load(bare.path)
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=dict))
    frame = loaded.frame()
    assert list(frame)[:2] == ["step", "seed"]
    rows = np.genfromtxt(bare.metrics, delimiter=",", names=True, deletechars="")
    np.testing.assert_equal(frame, {name: rows[name] for name in rows.dtype.names})
    with pytest.raises(ValueError, match="unknown option 'learning'; did you mean 'learning_rate'"):
        loaded.frame("learning")
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ValueError, match="a frame needs pandas: pip install pandas"):
        loaded.frame()


def test_the_frames_of_runs_can_be_told_apart_by_any_option_defaults_too(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=dict))
    own = tiny_train("naive", steps=80, learning_rate=[1e-3, 3e-4], hidden_sizes=(16,), out=tmp_path / "own")
    names = ("algo", "learning_rate", "discount", "hidden_sizes", "train_horizon", "alive_steps")
    for result in (own, earl_jax.load(own.folder)):
        columns = list(result.frame(*names).values())[-len(names) :]
        assert columns[:2] == [["naive"] * 4, [1e-3, 3e-4] * 2]
        assert [set(column) for column in columns[2:]] == [{0.99}, {(16,)}, {200_000}, {2000}]


def test_a_result_is_shown_in_a_few_lines_and_text_of_others_as_text(trained, bare):
    assert repr(earl_jax.load(bare.path)) == repr(trained[1]).replace(str(trained[0]), str(bare.path))
    change_config(bare.path, options={"<b>": "\x1b[31m"})
    loaded = earl_jax.load(bare.path)
    assert len(repr(loaded).splitlines()) < 15
    assert "fbrl (<b>=\\x1b[31m)" in repr(loaded)
    assert "fbrl (&lt;b&gt;=\\x1b[31m)" in loaded._repr_html_()
