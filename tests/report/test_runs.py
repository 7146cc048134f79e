"""Curves read from run folders, in the order and with the labels of tables."""

import dataclasses
from importlib import metadata

import numpy as np
import pytest

from earl_jax.protocol import Continuing
from earl_jax.report.pooling import read_all
from earl_jax.report.runs import by_method, labels, read
from tests.report.run_files import DOOR, TABLETOP, change_config, rising, write_run


def test_groups_are_in_the_order_of_the_paper_with_labels_that_differ(tmp_path):
    paths = [
        write_run(tmp_path / "a", DOOR, "oracle", rising(1, 1)),
        write_run(tmp_path / "b", TABLETOP, "fbrl", rising(1, 1), reward_scale=1.0),
        write_run(tmp_path / "c", TABLETOP, "fbrl", rising(1, 1)),
        write_run(tmp_path / "d", TABLETOP, "naive", rising(1, 1)),
    ]
    groups = [(group.env, group.label) for group in by_method(read_all(paths))]
    assert groups == [
        (TABLETOP, "naive"), (TABLETOP, "fbrl (reward_scale=1)"), (TABLETOP, "fbrl (reward_scale=10)"), (DOOR, "oracle"),
    ]  # fmt: skip


def test_labels_have_the_options_that_differ_within_a_method_and_those_of_task_and_setting(tmp_path):
    small = {"hidden_sizes": (32, 32), "learning_rate": 3e-4}
    runs = {
        "a": {**small, "learner": "td3", "policy_delay": 3},
        "b": {**small, "setting": Continuing(budget=20.0)},
        "c": {**small, "env_options": {"wide": True}},
    }
    paths = [write_run(tmp_path / name, TABLETOP, "fbrl", rising(1, 1), **options) for name, options in runs.items()]
    others = [
        write_run(tmp_path / "d", TABLETOP, "naive", rising(1, 1), reward_scale=1.0),
        write_run(tmp_path / "e", DOOR, "oracle", rising(1, 1)),
    ]
    assert labels(read_all([*paths, *others])) == [
        "fbrl (budget=None, learner=td3, setting=deployment, wide=False)",
        "fbrl (budget=20, learner=sac, setting=continuing, wide=False)",
        "fbrl (budget=None, learner=sac, setting=deployment, wide=True)",
        "naive (budget=None, learner=sac, setting=deployment, wide=False)",
        "oracle",
    ]
    for path in paths[:2]:
        change_config(path, algo="theirs")
    assert labels(read_all(paths[:2])) == [
        "theirs (budget=None, learner=td3, policy_delay=3, setting=deployment)",
        "theirs (budget=20, learner=default, policy_delay=default, setting=continuing)",
    ]


def test_learners_tell_runs_apart_without_the_options_that_only_one_of_them_has(tmp_path):
    """Runs with a learner that is not known here have all of its options."""
    runs = {
        "a": ("fbrl", {"learner": "tqc", "dropped": 2, "discount": 0.9}),
        "b": ("fbrl", {"learner": "crossq", "momentum": 0.9, "discount": 0.9}),
        "c": ("fbrl", {"learner": "crossq", "momentum": 0.5, "discount": 0.9}),
        "d": ("naive", {"discount": 0.9}),
    }
    paths = [write_run(tmp_path / name, TABLETOP, algo, rising(1, 1), discount=0.9) for name, (algo, _) in runs.items()]
    for path, (_, options) in zip(paths, runs.values(), strict=True):
        change_config(path, options=options)
    assert labels(read_all(paths)) == [
        "fbrl (learner=tqc)",
        "fbrl (learner=crossq, momentum=0.9)",
        "fbrl (learner=crossq, momentum=0.5)",
        "naive (learner=sac)",
    ]


def test_a_known_method_on_an_unknown_task_is_labelled_with_its_own_default(tmp_path, monkeypatch):
    paths = [write_run(tmp_path / str(n), TABLETOP, "fbrl", rising(1, 1), reward_scale=n) for n in (1.0, 10.0)]
    for path in paths:
        change_config(path, env="theirs")
    assert labels(read_all(paths)) == ["fbrl (reward_scale=1)", "fbrl (reward_scale=10)"]
    theirs = dataclasses.make_dataclass("Theirs", [("places", tuple, dataclasses.field(default_factory=tuple))])
    monkeypatch.setattr("earl_jax.report.runs.env_class", {"theirs": theirs}.get)
    change_config(paths[0], env_options={"places": [1, 2]})
    assert labels(read_all(paths))[1] == "fbrl (places=default, reward_scale=10)"


def test_a_rate_outside_of_0_to_1_is_refused_with_its_place(tmp_path):
    path = write_run(tmp_path / "percent", TABLETOP, "naive", [[0.0, 60.0], [0.5, np.nan]], seeds=(7, 8))
    with pytest.raises(
        ValueError, match=r"percent/metrics.csv is damaged: deployed/success of seed 7 at step 20 is 60, not from 0"
    ):
        read(path)


def test_no_package_is_searched_to_know_whether_a_run_is_comparable(tmp_path, monkeypatch):
    runs = [read(write_run(tmp_path / env, env, "naive", rising(1, 1))) for env in (TABLETOP, "cheetah_run")]
    monkeypatch.delattr(metadata, "entry_points")
    assert [run.comparable for run in runs] == [True, False]
