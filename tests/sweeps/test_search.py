"""Searches: Optuna proposes, runs below the median end, and a kill changes nothing. A formula replaces the training of runs."""

import json
import re
import signal
import sys
import warnings
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import search as module, worker
from earl_jax.sweeps.search import search
from earl_jax.training.stopping import Stopped
from tests.cli.process import one_line, run, succeed

SPACE = """
envs = ["tabletop_organization"]
algos = ["naive"]
seeds = 2
steps = 120
eval_every = 40
[options]
batch_size = 16
learning_rate = { log_uniform = [1e-5, 1e-1] }
discount = { uniform = [0.9, 0.99] }
random_steps = { integers = [1, 4] }
hidden_sizes = { choice = [[16], [32, 32]] }
replay_capacity = { choice = ["null"] }
"""


@pytest.fixture
def space(tmp_path):
    path = tmp_path / "space.toml"
    path.write_text(SPACE)
    return path


@pytest.fixture
def batches(monkeypatch):
    """The batches of runs that are asked to be trained, as (steps, names); their score is 1 at a discount of 0.95."""
    pytest.importorskip("optuna", reason="search needs the extra 'search'")
    done = []

    def work(out, configs, emit, devices=None, limit=None):
        done.append((next(iter(configs.values())).steps, sorted(configs)))
        for name, config in configs.items():
            score = 1 - abs(config.options.get("discount", 0.99) - 0.95)
            score = np.nan if config.options.get("reward_scale") == 0.5 else score
            metrics = {"deployed/return": np.zeros(2), config.deployed_metric: np.full(2, score)}
            exists = (out / name).exists()
            folder = RunFolder.open(out / name) if exists else RunFolder.create(out / name, config, "kinematic")
            for step in range(folder.table().step + 40, config.steps + 1, 40):
                folder.append(step, metrics)
            folder.record(steps=config.steps)

    monkeypatch.setattr(module, "work", work)
    monkeypatch.setattr(worker, "require_checkpoint", lambda folder, step: None)  # these runs have none
    return done


def test_batches_are_trained_through_the_rungs_and_halved(space, tmp_path, batches):
    code, out, err = run("search", space, "--out", tmp_path / "out", "--trials", "8", "--batch", "4", "--json")
    assert (code, err) == (0, "")
    values = json.loads(out)
    assert [(steps, len(names)) for steps, names in batches[:3]] == [(40, 4), (80, 2), (120, 1)]
    assert set(batches[2][1]) <= set(batches[1][1]) <= set(batches[0][1])
    trials = values["trials"]
    assert {trial["state"] for trial in trials} == {"done", "pruned"}
    assert min(trials[:4], key=lambda trial: trial["scores"]["40"])["state"] == "pruned"
    assert sum("pruned" in line for line in values["lines"]) == values["pruned"] == 8 - values["done"]
    best = values["best"]
    assert best["options"]["replay_capacity"] is None
    assert best["scores"]["120"] == max(trial["scores"].get("120", 0) for trial in trials)
    assert not values["stopped"]
    folder = next((tmp_path / "out/tabletop_organization/naive").glob(f"*discount={best['options']['discount']},*"))
    assert RunFolder.open(folder).config.steps == 120


@pytest.mark.parametrize("sampler", ["tpe", "random", "qmc"])
def test_a_search_that_is_killed_ends_as_one_that_is_not(space, tmp_path, batches, monkeypatch, sampler):
    space.write_text(f"sampler = '{sampler}'\n" + SPACE)
    arguments = {"batch": 2, "rungs": 2, "emit": lambda line: None}
    whole = search(space, tmp_path / "whole", trials=4, **arguments)
    discounts = {trial.options["discount"] for trial in whole}
    assert len(discounts) == 4
    assert discounts == {float(f"{discount:.4g}") for discount in discounts}
    train, calls = module.work, []

    def killed(*positional, **options):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return train(*positional, **options)

    monkeypatch.setattr(module, "work", killed)
    with pytest.raises(KeyboardInterrupt):
        search(space, tmp_path / "out", trials=2, **arguments)
    (tmp_path / "out/search.journal.lock").symlink_to("search.journal")  # as a kill can leave it
    assert search(space, tmp_path / "out", trials=4, **arguments) == whole
    (tmp_path / "other.toml").write_text(space.read_text().replace("0.99]", "0.9]"))
    differences = r"options\.discount FloatD.*=0.99, .* there, FloatD.*=0.9, .* here; rungs \(80, 120\) there, \(40, 8"
    with pytest.raises(ValueError, match=rf"search\.journal is of a search that differs \({differences}"):
        search(tmp_path / "other.toml", tmp_path / "out", trials=4, **{**arguments, "rungs": 3})
    journal = tmp_path / "out/search.journal"
    journal.write_text(re.sub(r'"search": ?\{.*?\}', '"search": "text"', journal.read_text()))
    with pytest.raises(ValueError, match=r"search\.journal was begun by another version of earl_jax"):
        search(space, tmp_path / "out", trials=4, **arguments)
    others = search(space, tmp_path / "other", trials=2, seed=1, **arguments)
    assert [trial.options for trial in others] != [trial.options for trial in whole[:2]]


def test_a_run_that_fails_is_named_and_its_score_is_not_used(space, tmp_path, batches, monkeypatch):
    train = module.work

    def failing(out, configs, emit, **options):
        first, *others = configs
        emit(first, "failed", "OSError: no space left")
        train(out, {name: configs[name] for name in others}, emit, **options)

    monkeypatch.setattr(module, "work", failing)
    lines = []
    history = search(space, tmp_path / "out", trials=3, batch=3, rungs=1, emit=lines.append)
    assert sorted(trial.state for trial in history) == ["done", "done", "failed"]
    for trial in history:
        if trial.state == "done":
            assert RunFolder.open(tmp_path / "out" / trial.name).config.options.items() >= trial.options.items()
    assert any(line.startswith("failed") and line.endswith("OSError: no space left") for line in lines)


def test_a_signal_leaves_one_json_object(space, tmp_path, batches, monkeypatch):
    monkeypatch.setattr(module, "work", Mock(side_effect=Stopped(signal.SIGTERM, 40, None)))
    code, out, err = run("search", space, "--out", tmp_path / "out", "--json")
    assert (code, err) == (128 + signal.SIGTERM, "earl-jax: stopped at step 40; repeat the command to continue\n")
    values = {"out": str(tmp_path / "out"), "lines": [], "resume": "repeat the command", "steps": 40, "stopped": True}
    assert json.loads(out) == values


@pytest.mark.parametrize("rungs", [1, 3, 2**31 - 1])
def test_a_trial_whose_score_is_nan_has_failed(space, tmp_path, batches, rungs):
    space.write_text(SPACE + "reward_scale = 0.5\n")
    lines = []
    with warnings.catch_warnings(action="error", category=RuntimeWarning):
        history = search(space, tmp_path / "out", trials=2, batch=2, rungs=rungs, emit=lines.append)
    assert [trial.state for trial in history] == [line.split()[0] for line in lines] == ["failed"] * 2
    code, out, _ = run("search", space, "--out", tmp_path / "out", "--trials", 2, "--rungs", rungs)
    assert (code, "2 failed" in out) == (1, True), "no trial has a score"


def test_minutes_leave_the_trials_running(space, tmp_path, batches, monkeypatch):
    monkeypatch.setattr(module, "work", lambda *arguments, **options: None)
    arguments = ("search", space, "--out", tmp_path / "out", "--trials", "2", "--minutes", "1e-9")
    out = succeed(*arguments)
    assert "repeat the command to continue" in out
    assert "2 running" in out
    values = json.loads(succeed(*arguments, "--json"))
    assert (values["stopped"], values["running"], values["best"]) == (True, 2, None)


@pytest.mark.parametrize(
    ("content", "message"), [("{}\n{}\n", "is damaged"), ("no\nJSON\n", "is damaged"), (None, "is a link")]
)
def test_a_damaged_journal_or_a_link_is_one_line(space, tmp_path, batches, content, message):
    (tmp_path / "out").mkdir()
    journal = tmp_path / "out/search.journal"
    journal.symlink_to(tmp_path / "victim") if content is None else journal.write_text(content)
    one_line(run("search", space, "--out", tmp_path / "out"), message)


def test_a_search_without_optuna_names_the_extra_and_leaves_no_folder(space, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    one_line(run("search", space, "--out", tmp_path / "out"), "search needs optuna: pip install 'optuna>=5'")
    assert not (tmp_path / "out").exists()


UNIFORM = "uniform = [0.9, 0.99]"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("= 16", "= [16, 32]"), "one value of each option"),
        (("[options]", "[[runs]]\n[options]"), r"a search has no \[\[runs\]\]"),
        (("[options]", "sampler = 'sobol'\n[options]"), "unknown sampler 'sobol'; choose from tpe, random, qmc"),
        (("uniform", "normal"), "must be a choice of values, or the two ends of uniform, log_uniform or integers"),
        ((UNIFORM, "uniform = [0, 1], choice = [1]"), "option discount = .* must be"),
        ((UNIFORM, "uniform = [0, inf]"), "not finite"),
        ((UNIFORM, "log_uniform = [0, 1]"), "low > 0"),
        ((UNIFORM, "integers = [1, 2.5]"), "integer"),
        ((UNIFORM, "choice = []"), "one or more"),
        (("discount", "reward_type"), "reward_type decides between success and return"),
        ((SPACE[SPACE.index("learning_rate") :], ""), "needs options with a distribution"),
        ((UNIFORM, "uniform = [0.9, 2.0]"), r"discount must lie in .*, not 2"),
        (("[1, 4]", "[-5, 4]"), "random_steps must .*, not -5"),
        (("[[16], [32, 32]]", "[[16], [0]]"), "hidden_sizes must be"),
        ({"trials": 0}, r"trials must lie in \[1, 2147483647\], not 0"),
        ({"devices": 0}, r"devices must lie in \[1, 2147483647\], not 0"),
        ({"devices": 2}, "2 devices requested, but 1 available"),
        ({"out": Path("gs://a/out")}, "gs:/a/out is an address"),
        ({"seed": 2**32}, r"seed must lie in \[0, 2147483647\], not 4294967296"),
        ({"batch": 2.5}, "batch must be a whole number, not 2.5"),
    ],
)
def test_a_space_with_a_value_that_could_be_invalid_is_refused_at_once(space, tmp_path, batches, change, message):
    arguments = {"out": tmp_path / "out", "trials": 1}
    if isinstance(change, dict):
        arguments |= change
    else:
        space.write_text(SPACE.replace(*change))
    with pytest.raises(ValueError, match=message):
        search(space, **arguments)
    assert not batches
    assert not (tmp_path / "out").exists()
