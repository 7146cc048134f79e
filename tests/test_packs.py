"""Packs: cells that share a program, kept apart, each as if it had run alone."""

import json
import sys

import jax
import pytest

from earl_jax.algos import method_for
from earl_jax.envs import make
from earl_jax.runs.folder import RunFolder
from earl_jax.sweeps import planner as packs
from earl_jax.training import runner as program
from earl_jax.training import load_lanes, train
from tests.conftest import TINY, assert_same, newborn

GRID = """
envs = ["tabletop_organization"]
algos = ["naive", "oracle"]
seeds = 2
steps = 120
eval_every = 40
eval_episodes = 2
checkpoint_every = 40
[options]
hidden_sizes = [[16, 16]]
batch_size = 16
random_steps = 20
eval_horizon = 30
"""
SLUG = "batch_size=16,eval_horizon=30,hidden_sizes=16x16,random_steps=20"
NAMES = [f"tabletop_organization/{algo}/{SLUG}" for algo in ("naive", "oracle")]
LENGTHS = {"seeds": 2, "steps": 120, "eval_every": 40, "eval_episodes": 2, "checkpoint_every": 40}


@pytest.fixture
def grid(tmp_path):
    path = tmp_path / "grid.toml"
    path.write_text(GRID)
    return path


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    folders = tmp_path_factory.mktemp("alone")
    for algo in ("naive", "oracle"):
        env = make("tabletop_organization", eval_horizon=30)  # so short that the oracle is reset within the run
        method = method_for(env, algo, **TINY)
        train(env, method, out=folders / algo, **LENGTHS)
    return [folders / algo for algo in ("naive", "oracle")]


def worked(plan, out):
    told = []
    experiments = {name: packs.experiment_of(cell["experiment"]) for name, cell in plan["cells"].items()}
    well = packs.work(out, experiments, lambda name, state, **more: told.append((name, state, more)), progress=False)
    return well, told


def assert_as_alone(out, alone):
    for name, folder in zip(NAMES, alone, strict=True):
        assert (out / name / "metrics.csv").read_bytes() == (folder / "metrics.csv").read_bytes()
        mine, its = (load_lanes(RunFolder.open(path))[2] for path in (out / name, folder))
        assert_same(mine, its)


def test_the_two_methods_do_differ(alone):
    tables = [(folder / "metrics.csv").read_text() for folder in alone]
    assert tables[0] != tables[1]


def test_two_methods_in_one_program_are_each_as_alone(tmp_path, grid, alone):
    plan = packs.plan(grid, tmp_path / "out")
    assert [pack["cells"] for pack in plan["packs"]] == [NAMES]
    assert not (tmp_path / "out").exists()
    well, told = worked(plan, tmp_path / "out")
    assert well
    assert [state for _, state, _ in told] == ["started", "started", "done", "done"]
    assert_as_alone(tmp_path / "out", alone)
    again = packs.plan(grid, tmp_path / "out")
    assert not again["packs"]
    assert {cell["step"] for cell in again["cells"].values()} == {120}
    assert worked(again, tmp_path / "out") == (True, [(name, "done", {}) for name in NAMES])


def test_cells_stopped_between_their_checkpoints_go_on_apart(tmp_path, grid, alone, monkeypatch):
    saves = []

    def stops(folder, lives, span):
        saves.append(int(lives.step))
        if len(saves) == 4:
            raise OSError("no space left")
        return real(folder, lives, span)

    real = program.save
    monkeypatch.setattr(program, "save", stops)
    out = tmp_path / "out"
    well, told = worked(packs.plan(grid, out), out)
    assert not well
    assert saves == [40, 40, 80, 80]
    assert told[-1] == (NAMES[1], "failed", {"why": "OSError: no space left"})
    monkeypatch.setattr(program, "save", real)
    plan = packs.plan(grid, out)
    assert [(pack["cells"], pack["step"]) for pack in plan["packs"]] == [(NAMES[:1], 80), (NAMES[1:], 40)]
    well, told = worked(plan, out)
    assert well
    assert ("resumed", {"step": 80}) in [entry[1:] for entry in told]
    assert_as_alone(out, alone)


def test_packs_hold_what_fits_one_program(tmp_path, grid):
    grid.write_text(
        GRID.replace('"oracle"', '"oracle", "fbrl"') + "reward_scale = [1, 10]\nlayer_norm = [true, false]\n"
    )
    plan = packs.plan(grid, tmp_path)
    assert [pack["lanes"] for pack in plan["packs"]] == [8, 8, 4, 4]
    for pack in plan["packs"]:
        assert len({("fbrl" in name, "layer_norm=true" in name) for name in pack["cells"]}) == 1
    split = packs.plan(grid, tmp_path, max_lanes=5)["packs"]
    assert [pack["lanes"] for pack in split] == [4] * 6
    assert sorted(name for pack in split for name in pack["cells"]) == sorted(plan["cells"])
    with pytest.raises(ValueError, match="has 2 seeds, more than 1 lanes"):
        packs.plan(grid, tmp_path, max_lanes=1)


def test_other_tasks_and_lengths_are_other_programs(tmp_path, grid):
    runs = "[[runs]]\noptions = { wide = true }\n[[runs]]\nsteps = 240\nalgos = ['naive']\n"
    grid.write_text(GRID + runs)
    plan = packs.plan(grid, tmp_path)
    assert [pack["steps"] for pack in plan["packs"]] == [240, 120, 120]
    assert sum(pack["lanes"] for pack in plan["packs"]) == 8


def test_the_plan_says_how_much_the_replay_takes(tmp_path, grid, problem):
    grid.write_text(GRID.replace('"naive", "oracle"', '"vaprl"'))
    plan = packs.plan(grid, tmp_path)
    [cell] = plan["cells"].values()
    method = program.per_lane(packs.experiment_of(cell["experiment"]).build_method(), 2)
    replay = newborn(problem, method, [0, 1], steps=120).replay
    born = sum(leaf.nbytes for leaf in jax.tree.leaves(replay))
    assert plan["packs"][0]["replay_bytes"] == pytest.approx(born, rel=0.01)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (("naive", "ppo"), ["unknown algo 'ppo'", "vaprl"]),
        (("tabletop_organization", "cheetah"), ["unknown env 'cheetah'", "sawyer_door"]),
        (
            ("batch_size", "bath_size"),
            ["tabletop_organization/naive/bath_size=16", "no option 'bath_size'", "discount"],
        ),
        (("steps = 120", "steps = 100"), ["not a multiple of eval_every"]),
        (("seeds = 2", "seeds = [1, 1]"), ["distinct"]),
        (('"oracle"]', '"vaprl"]\n[[runs]]\nenvs = "fish_swim"\nalgos = "vaprl"'), ["vaprl needs demonstrations"]),
    ],
)
def test_mistakes_are_found_before_anything_starts(tmp_path, grid, changed, words, capsys):
    text = GRID if "[[runs]]" not in changed[1] else GRID[: GRID.index("[options]")]
    grid.write_text(text.replace(*changed))
    assert packs.main(["plan", str(grid), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert len(told.strip().splitlines()) == 1
    for word in words:
        assert word in told
    assert not (tmp_path / "out").exists()


def test_a_folder_of_another_run_is_refused_and_left_alone(tmp_path, grid):
    entries = packs.plan(grid, tmp_path)["cells"]
    config = packs.experiment_of(entries[NAMES[0]]["experiment"])
    folder = RunFolder.create(tmp_path / NAMES[0], config)
    assert packs.plan(grid, tmp_path)["packs"][0]["cells"] == NAMES
    before = (folder.path / "config.json").read_bytes()
    grid.write_text(GRID.replace("steps = 120", "steps = 240").replace("seeds = 2", "seeds = 3"))
    with pytest.raises(
        ValueError, match=r"seeds \[0, 1\] there, \[0, 1, 2\] in the grid; steps 120 there, 240 in the grid"
    ):
        packs.plan(grid, tmp_path)
    assert (folder.path / "config.json").read_bytes() == before


def test_one_folder_has_one_worker(tmp_path, grid):
    plan = packs.plan(grid, tmp_path)
    plan["cells"] = {NAMES[0]: plan["cells"][NAMES[0]]}
    folder = RunFolder.create(tmp_path / NAMES[0], packs.experiment_of(plan["cells"][NAMES[0]]["experiment"]))
    with folder.claimed():
        well, told = worked(plan, tmp_path)
    assert not well
    assert "is in use by another process" in told[0][2]["why"]
    assert not folder.metrics.exists()


def test_a_kill_while_a_folder_is_made_does_no_harm(tmp_path, grid):
    config = packs.experiment_of(packs.plan(grid, tmp_path)["cells"][NAMES[0]]["experiment"])
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell/config.json.part").write_text("{")
    with packs.claimed(tmp_path / "cell", config) as folder:
        assert RunFolder.open(folder.path).config.steps == 120
    (tmp_path / "other").mkdir()
    (tmp_path / "other/thesis.tex").write_text("all of it")
    with pytest.raises(ValueError, match="not an empty folder"), packs.claimed(tmp_path / "other", config):
        pass


def test_a_worker_that_is_told_nothing_it_can_do_says_so(tmp_path, grid, monkeypatch, capsys):
    plan = packs.plan(grid, tmp_path)
    (tmp_path / NAMES[0]).mkdir(parents=True)
    (tmp_path / NAMES[0] / "config.json").write_text("{}")
    cells = {NAMES[0]: plan["cells"][NAMES[0]]["experiment"]}
    told = tmp_path / "stdin"
    told.write_text(json.dumps({"out": str(tmp_path), "cells": cells}) + "\n")
    with told.open() as handle:
        monkeypatch.setattr(sys, "stdin", handle)
        monkeypatch.setattr(packs, "_end_with", lambda descriptor: None)
        assert packs.main(["work"]) == 1
    event = json.loads(capsys.readouterr().out)
    assert (event["cell"], event["state"]) == (NAMES[0], "failed")
    assert "config.json is damaged" in event["why"]
