"""Searches: Optuna proposes and prunes, and a kill changes nothing. The training of runs is replaced by a formula."""

import json
import sys

import pytest

from earl_jax.runs.config import deployed_metric
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import search as module
from earl_jax.sweeps.search import below_median, search
from tests.cli.process import run

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
random_steps = { integers = [1, 16] }
hidden_sizes = { choice = [[16], [32, 32]] }
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
            metrics = {"deployed/return": 0.0, deployed_metric(config.build_env()): score}
            exists = (out / name).exists()
            folder = RunFolder.open(out / name) if exists else RunFolder.create(out / name, config, "kinematic")
            for step in range(40 * (1 + len(folder.rows()) // 2), config.steps + 1, 40):
                folder.append([{"step": step, "seed": seed, **metrics} for seed in range(2)])
        return True

    monkeypatch.setattr(module, "work", work)
    return done


def test_batches_are_trained_through_the_rungs_and_halved(space, tmp_path, batches):
    code, out, err = run("search", space, "--out", tmp_path / "out", "--trials", "8", "--batch", "4", "--json")
    assert (code, err) == (0, "")
    values = json.loads(out)
    assert [steps for steps, _ in batches[:3]] == [40, 80, 120]
    assert len(batches[0][1]) == 4
    assert len(batches[1][1]) <= 3
    assert set(batches[2][1]) <= set(batches[1][1]) <= set(batches[0][1])
    trials = values["trials"]
    assert {trial["state"] for trial in trials} == {"done", "pruned"}
    assert min(trials[:4], key=lambda trial: trial["scores"]["40"])["state"] == "pruned"
    assert sum("pruned" in line for line in values["lines"]) == values["pruned"] == 8 - values["done"]
    best = values["best"]
    assert best["scores"]["120"] == max(trial["scores"].get("120", 0) for trial in trials)
    assert not values["stopped"]
    folder = next((tmp_path / "out/tabletop_organization/naive").glob(f"*discount={best['options']['discount']},*"))
    assert RunFolder.open(folder).config.steps == 120


@pytest.mark.parametrize("sampler", ["tpe", "random", "qmc"])
def test_a_search_that_is_killed_ends_as_one_that_is_not(space, tmp_path, batches, monkeypatch, sampler):
    space.write_text(f"sampler = '{sampler}'\n" + SPACE)
    arguments = {"batch": 4, "rungs": 2, "emit": lambda line: None}
    whole = search(space, tmp_path / "whole", trials=8, **arguments)
    assert len({trial.options["discount"] for trial in whole}) == 8
    train, calls = module.work, []

    def killed(*positional, **options):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return train(*positional, **options)

    monkeypatch.setattr(module, "work", killed)
    with pytest.raises(KeyboardInterrupt):
        search(space, tmp_path / "out", trials=4, **arguments)
    (tmp_path / "out/search.journal.lock").symlink_to("search.journal")  # as a kill can leave it
    assert search(space, tmp_path / "out", trials=8, **arguments) == whole
    with pytest.raises(ValueError, match=r"search\.journal is of a search with other values"):
        search(space, tmp_path / "out", trials=8, **{**arguments, "rungs": 3})
    others = search(space, tmp_path / "other", trials=4, seed=1, **arguments)
    assert [trial.options for trial in others] != [trial.options for trial in whole[:4]]


@pytest.mark.parametrize("sampler", ["random", "qmc"])
def test_samples_follow_their_distributions(sampler):
    optuna = pytest.importorskip("optuna", reason="search needs the extra 'search'")
    kinds = {"log": {"log_uniform": [1e-5, 1e-1]}, "whole": {"integers": [1, 4]}, "one": {"choice": [[16], [32, 32]]}}
    spaces = {name: module._space(distribution) for name, distribution in kinds.items()}
    study = module.Search(None, spaces, None, (), optuna.create_study(), None, None, None)
    study.ask(128, sampler, seed=1)
    drawn = [trial.options for trial in study.history()]
    assert sum(options["log"] < 1e-3 for options in drawn) == pytest.approx(64, abs=16)
    assert all(float(f"{options['log']:.4g}") == options["log"] for options in drawn)
    assert all([options["whole"] for options in drawn].count(size) > 16 for size in range(1, 5))
    assert 40 < [options["one"] for options in drawn].count([16]) < 88


def test_a_run_that_fails_is_named_and_its_score_is_not_used(space, tmp_path, batches, monkeypatch):
    train = module.work

    def failing(out, configs, emit, **options):
        first, *others = configs
        emit(first, "failed", why="OSError: no space left")
        return train(out, {name: configs[name] for name in others}, emit, **options) and False

    monkeypatch.setattr(module, "work", failing)
    lines = []
    history = search(space, tmp_path / "out", trials=3, batch=3, rungs=1, emit=lines.append)
    assert sorted(trial.state for trial in history) == ["done", "done", "failed"]
    assert any(line.startswith("failed") and line.endswith("OSError: no space left") for line in lines)


def test_minutes_leave_the_trials_running(space, tmp_path, batches, monkeypatch):
    monkeypatch.setattr(module, "work", lambda *arguments, **options: True)
    code, out, _ = run("search", space, "--out", tmp_path / "out", "--trials", "2", "--minutes", "1")
    assert code == 0
    assert "repeat the command to continue" in out
    assert "2 running" in out
    values = json.loads(run("search", space, "--out", tmp_path / "out", "--trials", "2", "--json")[1])
    assert (values["stopped"], values["running"], values["best"]) == (True, 2, None)


def test_runs_below_the_median_are_pruned():
    pytest.importorskip("optuna", reason="search needs the extra 'search'")
    scores = [0.0, 1.0, 2.0, 3.0]
    assert [below_median(score, scores) for score in scores] == [True, True, False, False]
    assert not below_median(0.0, [0.0])


@pytest.mark.parametrize(
    ("content", "message"), [("{}\n{}\n", "is damaged"), ("no\nJSON\n", "is damaged"), (None, "is a link")]
)
def test_a_damaged_journal_or_a_link_is_one_line(space, tmp_path, batches, content, message):
    (tmp_path / "out").mkdir()
    journal = tmp_path / "out/search.journal"
    journal.symlink_to(tmp_path / "victim") if content is None else journal.write_text(content)
    code, _, err = run("search", space, "--out", tmp_path / "out")
    assert (code, len(err.splitlines())) == (2, 1)
    assert message in err


def test_without_optuna_the_error_names_the_extra(space, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    code, _, err = run("search", space, "--out", tmp_path / "out")
    assert (code, err) == (2, "earl-jax: search needs optuna: pip install 'earl-jax[search]'\n")
    assert not (tmp_path / "out").exists()
