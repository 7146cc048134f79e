"""Searches: Optuna proposes and prunes, and a kill changes nothing. The training of runs is replaced by a formula."""

import json
import sys

import pytest

from earl_jax.runs.config import deployed_metric
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import search as module
from earl_jax.sweeps.grid import read_space
from earl_jax.sweeps.search import best_trial, search
from earl_jax.sweeps.study import Trial, propose, to_prune
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

    def work(out, configs, emit, progress, devices, limit=None):
        done.append((next(iter(configs.values())).steps, sorted(configs)))
        for name, config in configs.items():
            score = 1 - abs(config.options.get("discount", 0.99) - 0.95)
            env = config.build_env()
            folder = (
                RunFolder.create(out / name, config, "kinematic")
                if not (out / name).exists()
                else RunFolder.open(out / name)
            )
            for step in range(40 * (1 + len(folder.rows()) // 2), config.steps + 1, 40):
                metrics = {"deployed/return": [0.0] * 2, deployed_metric(env): [score] * 2}
                rows = [{"step": step, "seed": s, **{k: v[s] for k, v in metrics.items()}} for s in range(2)]
                folder.append(rows)
        return True

    monkeypatch.setattr(module, "work", work)
    return done


def test_batches_are_trained_through_the_rungs_and_halved(space, tmp_path, batches):
    lines = []
    history = search(space, tmp_path / "out", trials=8, batch=4, rungs=3, emit=lines.append)
    assert [steps for steps, _ in batches[:3]] == [40, 80, 120]
    assert len(batches[0][1]) == 4
    assert len(batches[1][1]) <= 3
    assert set(batches[2][1]) <= set(batches[1][1]) <= set(batches[0][1])
    states = [trial.state for trial in history]
    assert len(states) == 8
    assert set(states) == {"done", "pruned"}
    worst = min(history[:4], key=lambda trial: trial.scores[40])
    assert worst.state == "pruned"
    best = best_trial(history)
    assert best.last == max(trial.last for trial in history)
    assert sum("pruned" in line for line in lines) == states.count("pruned")
    folder = next((tmp_path / "out/tabletop_organization/naive").glob(f"*discount={best.options['discount']},*"))
    assert RunFolder.open(folder).config.steps == 120


def test_a_search_that_is_killed_ends_as_one_that_is_not(space, tmp_path, batches, monkeypatch):
    whole = search(space, tmp_path / "whole", trials=8, batch=4, rungs=2, emit=lambda line: None)
    train, calls = module.work, []

    def killed(*arguments, **options):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return train(*arguments, **options)

    monkeypatch.setattr(module, "work", killed)
    with pytest.raises(KeyboardInterrupt):
        search(space, tmp_path / "out", trials=4, batch=4, rungs=2)
    assert search(space, tmp_path / "out", trials=8, batch=4, rungs=2, emit=lambda line: None) == whole
    with pytest.raises(ValueError, match=r"search\.json is of a search with other values"):
        search(space, tmp_path / "out", rungs=3)


def test_a_run_that_fails_is_named_and_its_score_is_not_used(space, tmp_path, batches, monkeypatch):
    train = module.work

    def failing(out, configs, emit, *arguments, **options):
        first, *others = configs
        emit(first, "failed", why="OSError: no space left")
        return train(out, {name: configs[name] for name in others}, emit, *arguments, **options) and False

    monkeypatch.setattr(module, "work", failing)
    lines = []
    history = search(space, tmp_path / "out", trials=3, batch=3, rungs=1, emit=lines.append)
    assert [trial.state for trial in history].count("failed") == 1
    assert any(line.startswith("failed") and line.endswith("OSError: no space left") for line in lines)


def test_minutes_leave_the_trials_running(space, tmp_path, batches, monkeypatch):
    monkeypatch.setattr(module, "work", lambda *arguments, **options: True)
    code, out, _ = run("search", space, "--out", tmp_path / "out", "--trials", "2", "--minutes", "1")
    assert code == 0
    assert "repeat the command to continue" in out
    assert "2 running" in out
    values = json.loads(run("search", space, "--out", tmp_path / "out", "--trials", "2", "--json")[1])
    assert (values["stopped"], values["running"], values["best"]) == (True, 2, None)


DISTRIBUTIONS = {"x": {"uniform": [0.0, 1.0]}, "h": {"choice": [[16], [32]]}, "n": {"integers": [1, 9]}}


def test_proposals_depend_on_the_trials_alone_and_move_to_what_scores_high():
    pytest.importorskip("optuna", reason="search needs the extra 'search'")
    trials = [Trial({"x": i / 40, "h": [16], "n": 1 + i % 9}, {10: -abs(i / 40 - 0.8)}, "done") for i in range(40)]
    proposed = propose(trials, DISTRIBUTIONS, 6, seed=0)
    assert proposed == propose(trials, DISTRIBUTIONS, 6, seed=0) != propose(trials, DISTRIBUTIONS, 6, seed=1)
    assert sum(abs(options["x"] - 0.8) < 0.3 for options in proposed) >= 4
    assert all(options["h"] in ([16], [32]) and 1 <= options["n"] <= 9 for options in proposed)


def test_the_lower_half_of_a_batch_is_pruned():
    pytest.importorskip("optuna", reason="search needs the extra 'search'")
    trials = [Trial({}, {10: float(i)}, "running") for i in range(4)] + [Trial({}, {}, "failed")]
    assert to_prune(trials, [0, 1, 2, 3], 10) == {0, 1}
    assert to_prune([*trials, *[Trial({}, {10: 9.0}, "done")] * 4], [0, 1, 2, 3], 10) == {0, 1, 2, 3}
    assert to_prune(trials[:1], [0], 10) == set()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('["naive"]', '["naive", "fbrl"]'), "one task, one method"),
        (("batch_size = 16", "batch_size = [16, 32]"), "one value of each option"),
        (("[options]", "samples = 3\n[options]"), "a search has no"),
        (("{ log_uniform", "{ normal"), "one of uniform"),
    ],
)
def test_files_that_are_no_space_are_refused(space, tmp_path, batches, change, message):
    space.write_text(SPACE.replace(*change))
    with pytest.raises(ValueError, match=message):
        search(space, tmp_path / "out")
    assert not batches


def test_a_space_is_a_run_and_distributions(space):
    base, distributions = read_space(space)
    assert base.options == {"batch_size": 16}
    assert set(distributions) == {"learning_rate", "discount", "hidden_sizes"}
    space.write_text("preset = 'quick'\n" + SPACE)
    assert read_space(space)[0].options.keys() == {"batch_size", "timeout_bootstrap", "demo_share", "layer_norm"}


def test_without_optuna_the_error_names_the_extra(space, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    code, _, err = run("search", space, "--out", tmp_path / "out")
    assert (code, err) == (2, "earl-jax: search needs optuna: pip install 'earl-jax[search]'\n")
    assert not (tmp_path / "out").exists()
