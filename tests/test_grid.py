"""Grids: what a file says, cell by cell, and what it may not say."""

import pytest

from earl_jax.sweeps import grid

BASE = """
envs = ["tabletop_organization", "sawyer_door"]
algos = ["naive", "oracle"]
seeds = 2
steps = 400
"""


def read(tmp_path, text):
    path = tmp_path / "grid.toml"
    path.write_text(text)
    return grid.read(path)


def test_every_combination_is_a_cell_with_its_own_folder(tmp_path):
    cells = read(tmp_path, BASE + "[options]\nreward_scale = [1, 10.0]\nhidden_sizes = [[16, 16]]\nlayer_norm = true\n")
    assert len(cells) == len({cell.name for cell in cells}) == 8
    one = cells[0]
    assert one.name == "tabletop_organization/naive/hidden_sizes=16x16,layer_norm=true,reward_scale=1"
    assert one.options == {"hidden_sizes": [16, 16], "layer_norm": True, "reward_scale": 1}
    assert (one.seeds, one.steps, one.eval_every, one.checkpoint_every) == ((0, 1), 400, 10_000, 100_000)


def test_a_name_depends_on_what_is_said_of_the_cell_alone(tmp_path):
    before = {cell.name for cell in read(tmp_path, BASE + "[options]\nreward_scale = 1\ndiscount = 0.9\n")}
    after = {cell.name for cell in read(tmp_path, BASE + "[options]\ndiscount = 0.90\nreward_scale = [2, 1.0]\n")}
    assert before < after


def test_names_are_safe_and_told_apart(tmp_path):
    files = ["/data/a.npz", "_data/a.npz", "x" * 300, "x" * 301]
    cells = read(tmp_path, f"envs='e'\nalgos='a'\n[options]\ndemo_file = {files}\n")
    folders = {cell.name.removeprefix("e/a/") for cell in cells}
    assert len(folders) == 4
    assert all("/" not in folder and len(folder) <= grid.LONGEST for folder in folders)


def test_runs_override_and_add(tmp_path):
    cells = read(
        tmp_path,
        BASE
        + """
[options]
reward_scale = 1
[[runs]]
envs = ["sawyer_door"]
steps = 800
[[runs]]
algos = "vaprl"
seeds = [7]
options = { epsilon = [0.1, 0.3], reward_scale = 2 }
""",
    )
    steps = {(cell.env, cell.algo): cell.steps for cell in cells if cell.algo != "vaprl"}
    assert steps["sawyer_door", "naive"] == steps["sawyer_door", "oracle"] == 800
    assert steps["tabletop_organization", "naive"] == 400
    added = [cell for cell in cells if cell.algo == "vaprl"]
    assert len(added) == 4
    assert {cell.options["epsilon"] for cell in added} == {0.1, 0.3}
    assert {(cell.seeds, cell.options["reward_scale"]) for cell in added} == {((7,), 2)}
    only = read(tmp_path, "steps = 40\n[[runs]]\nenvs = 'e'\nalgos = 'a'\n")
    assert [(cell.name, cell.steps) for cell in only] == [("e/a/default", 40)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("envs = [", "can't be read"),
        ("envs = 'e'\nalgos = 'a'\nstep = 3", "no key 'step'; choose from envs, algos"),
        ("envs = 'e'", "algos must name at least one"),
        ("envs = []\nalgos = 'a'", "envs must name at least one"),
        ("envs = 'e'\nalgos = 'a'\nsteps = 1.5", "steps must be a whole number"),
        ("envs = 'e'\nalgos = 'a'\nseeds = 0", "seeds must be a whole number of at least 1"),
        ("envs = 'e'\nalgos = 'a'\nseeds = true", "seeds must be a whole number"),
        ("envs = 'e'\nalgos = 'a'\nruns = 3", r"\[\[runs\]\]"),
        ("envs = 'e'\nalgos = 'a'\noptions = 3", r"\[options\]"),
        ("envs = 'e'\nalgos = 'a'\n[options]\nx = []", "option x"),
        ("envs = 'e'\nalgos = 'a'\n[options]\nx = [1, 1]", "option x"),
        ("envs = 'e'\nalgos = 'a'\n[options]\nhidden_sizes = [16, 32]", r"write it as \[\[256, 256\]\]"),
        ("[[runs]]\nenvs = 'e'\nalgos = 'a'\nstep = 3", "no key 'step'"),
    ],
)
def test_mistakes_are_named(tmp_path, text, words):
    with pytest.raises(ValueError, match=words):
        read(tmp_path, text)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere\.toml can't be read"):
        grid.read(tmp_path / "nowhere.toml")
