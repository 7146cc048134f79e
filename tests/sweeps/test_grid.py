"""Grids: the runs of a TOML file, their folder names, and the errors."""

import pytest

from earl_jax.options.schedule import Schedule
from earl_jax.sweeps import grid

RUN = "envs = 'e'\nalgos = 'a'\n"
BASE = """
envs = ["tabletop_organization", "sawyer_door"]
algos = ["naive", "oracle"]
seeds = "0:2"
steps = 400
"""


def read(tmp_path, text):
    path = tmp_path / "grid.toml"
    path.write_text(text)
    return grid.read(path)


def test_every_combination_is_a_run_with_its_own_folder(tmp_path):
    specs = read(tmp_path, BASE + "[options]\nreward_scale = [1, 10.0]\nhidden_sizes = [[16, 16]]\nlayer_norm = true\n")
    assert len(specs) == len({spec.name for spec in specs}) == 8
    first = specs[0]
    assert first.name == "tabletop_organization/naive/hidden_sizes=16x16,layer_norm=true,reward_scale=1"
    assert first.options == {"hidden_sizes": [16, 16], "layer_norm": True, "reward_scale": 1}
    assert (first.seeds, first.schedule) == ((0, 1), Schedule(steps=400))


def test_an_option_can_be_null_and_a_whole_number_can_have_an_exponent(tmp_path):
    specs = read(tmp_path, f"{RUN}steps = 1e3\noptions.replay_capacity = ['null', 1e3]")
    values = [(spec.schedule.steps, spec.options["replay_capacity"]) for spec in specs]
    assert repr(values) == "[(1000, None), (1000, 1000)]"
    assert [spec.name for spec in specs] == ["e/a/replay_capacity=null", "e/a/replay_capacity=1000"]


def test_a_grid_is_utf_8_with_or_without_a_byte_order_mark(tmp_path):
    for encoding in ("utf-8", "utf-8-sig"):
        (tmp_path / "grid.toml").write_text(f"{RUN}options.demo_file = 'ü.npz'", encoding)
        assert [spec.options for spec in grid.read(tmp_path / "grid.toml")] == [{"demo_file": "ü.npz"}]


def test_name_of_a_run_does_not_depend_on_other_runs(tmp_path):
    before = {spec.name for spec in read(tmp_path, BASE + "[options]\nreward_scale = 1\ndiscount = 0.9\n")}
    after = {spec.name for spec in read(tmp_path, BASE + "[options]\ndiscount = 0.90\nreward_scale = [2, 1.0]\n")}
    assert before < after


def test_names_are_valid_folder_names_and_unique(tmp_path):
    files = ["/data/a.npz", "_data/a.npz", "x" * 300, "x" * 301]
    folders = {spec.name.removeprefix("e/a/") for spec in read(tmp_path, f"{RUN}options.demo_file = {files}")}
    assert len(folders) == 4
    assert all("/" not in folder and len(folder) <= grid.LONGEST for folder in folders)


def test_runs_tables_override_and_add_runs(tmp_path):
    tables = """
[options]
reward_scale = 1
[[runs]]
envs = ["sawyer_door"]
steps = 800
[[runs]]
envs = ["sawyer_door"]
algos = "vaprl"
seeds = [7]
options = { epsilon = [0.1, 0.3], reward_scale = 2 }
"""
    specs = read(tmp_path, BASE + tables)
    assert {(spec.env, spec.algo): (spec.schedule.steps, spec.seeds) for spec in specs} == {
        ("tabletop_organization", "naive"): (400, (0, 1)),
        ("tabletop_organization", "oracle"): (400, (0, 1)),
        ("sawyer_door", "naive"): (800, (0, 1)),
        ("sawyer_door", "oracle"): (800, (0, 1)),
        ("sawyer_door", "vaprl"): (400, (7,)),
    }
    options = [(spec.options["epsilon"], spec.options["reward_scale"]) for spec in specs if spec.algo == "vaprl"]
    assert options == [(0.1, 2), (0.3, 2)]
    only = read(tmp_path, "steps = 40\n[[runs]]\nenvs = 'e'\nalgos = 'a'\n")
    assert [(spec.name, spec.schedule.steps) for spec in only] == [("e/a/default", 40)]


def test_a_preset_is_overridden_by_the_values_of_its_block(tmp_path):
    envs = "preset = 'strong'\nenvs = ['tabletop_organization', 'sawyer_door']\nalgos = 'naive'\n"
    specs = read(tmp_path, envs + "options.layer_norm = false")
    assert [(spec.schedule.steps, len(spec.seeds)) for spec in specs] == [(2_500_000, 5), (4_000_000, 5)]
    assert specs[0].options == {"layer_norm": False, "timeout_bootstrap": True}
    [quick] = read(tmp_path, f"{RUN}preset = 'quick'\nseeds = [7]\neval_every = 40\n")
    assert (quick.seeds, quick.schedule.eval_every, quick.options["hidden_sizes"]) == ((7,), 40, [64, 64])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("envs = [", r"grid\.toml can't be read"),
        (f"seeds = {'9' * 5000}", "can't be read"),
        (f"seeds = {'[' * 5000}", "can't be read"),
        (f"{RUN}step = 3", "unknown key 'step'; choose from preset, envs, algos"),
        (f"{RUN}[[runs]]\nimport = 'a.py'", r"above \[\[runs\]\], import is one too"),
        (f"{RUN}import = []", r"grid\.toml: import must contain at least one name"),
        (f"{RUN}import = 'a.py'", r"grid\.toml: .*a\.py can't be imported: there is no such file"),
        (f"{RUN}preset = 'huge'", "unknown preset 'huge'; choose from paper, quick, strong"),
        ("envs = 'e'", "algos must contain at least one name"),
        ("envs = []\nalgos = 'a'", "envs must contain at least one name"),
        (f"{RUN}steps = 1.5", "steps must be a whole number, not 1.5"),
        (f"{RUN}runs = 3", r"\[\[runs\]\]"),
        (f"{RUN}options = 3", r"\[options\]"),
        (f"{RUN}options.x = []", "option x"),
        (f"{RUN}options.x = [1, 1]", "option x"),
        (f"{RUN}options.x = [1, {'9' * 400}]", "option x is or holds a number that is too large"),
        (f"{RUN}options.x = {{ uniform = [0, 1] }}", "x is for a search: earl-jax search draws"),
        (f"{RUN}options.hidden_sizes = [16, 32]", r"write it as \[\[16, 32\]\]"),
        (f"{RUN}options.hidden_sizes = [32, 32]", r"write it as \[\[32, 32\]\]"),
        (RUN + "".join(f"options.x{n} = {list(range(9))}\n" for n in range(9)), "more than 10000 runs"),
    ],
)
def test_invalid_grids_are_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, text)
