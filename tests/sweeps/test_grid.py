"""Tests of grids: the runs of a TOML file, their folder names, and the errors."""

import pytest

from earl_jax.sweeps import grid

BASE = """
envs = ["tabletop_organization", "sawyer_door"]
algos = ["naive", "oracle"]
seeds = 2
steps = 400
"""

SPACE = "envs = 'e'\nalgos = 'a'\noptions.x = { uniform = [0, 1] }\n"
PRODUCT = "\n".join(f"x{number} = {list(range(9))}" for number in range(9))
"""Options with 9^9 combinations."""


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
    assert (first.seeds, first.steps, first.eval_every, first.checkpoint_every) == ((0, 1), 400, 10_000, 100_000)


def test_name_of_a_run_does_not_depend_on_other_runs(tmp_path):
    before = {spec.name for spec in read(tmp_path, BASE + "[options]\nreward_scale = 1\ndiscount = 0.9\n")}
    after = {spec.name for spec in read(tmp_path, BASE + "[options]\ndiscount = 0.90\nreward_scale = [2, 1.0]\n")}
    assert before < after


def test_names_are_valid_folder_names_and_unique(tmp_path):
    files = ["/data/a.npz", "_data/a.npz", "x" * 300, "x" * 301]
    specs = read(tmp_path, f"envs='e'\nalgos='a'\n[options]\ndemo_file = {files}\n")
    folders = {spec.name.removeprefix("e/a/") for spec in specs}
    assert len(folders) == 4
    assert all("/" not in folder and len(folder) <= grid.LONGEST for folder in folders)


def test_runs_tables_override_and_add_runs(tmp_path):
    specs = read(
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
    steps = {(spec.env, spec.algo): spec.steps for spec in specs if spec.algo != "vaprl"}
    assert steps["sawyer_door", "naive"] == steps["sawyer_door", "oracle"] == 800
    assert steps["tabletop_organization", "naive"] == 400
    added = [spec for spec in specs if spec.algo == "vaprl"]
    assert len(added) == 4
    assert {spec.options["epsilon"] for spec in added} == {0.1, 0.3}
    assert {(spec.seeds, spec.options["reward_scale"]) for spec in added} == {((7,), 2)}
    only = read(tmp_path, "steps = 40\n[[runs]]\nenvs = 'e'\nalgos = 'a'\n")
    assert [(spec.name, spec.steps) for spec in only] == [("e/a/default", 40)]


@pytest.mark.parametrize(("seeds", "expected"), [("'5:8'", (5, 6, 7)), ("'2'", (0, 1)), ("'1:3,8'", (1, 2, 8))])
def test_seeds_can_be_a_range_as_in_the_shell(tmp_path, seeds, expected):
    [spec] = read(tmp_path, f"envs = 'e'\nalgos = 'a'\nseeds = {seeds}\n")
    assert spec.seeds == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("envs = [", "can't be read"),
        ("envs = 'e'\nalgos = 'a'\nstep = 3", "unknown key 'step'; choose from preset, envs, algos"),
        ("envs = 'e'\nalgos = 'a'\npreset = 'huge'", "unknown preset 'huge'; choose from paper, quick, strong"),
        (SPACE, "x is for a search: earl-jax search draws"),
        ("envs = 'e'\nalgos = 'a'\nsamples = 3", "samples is for a search: earl-jax search draws"),
        ("envs = 'e'\nalgos = 'a'\nsampler = 'sobol'", "sampler is for a search: earl-jax search draws"),
        ("envs = 'e'", "algos must contain at least one name"),
        ("envs = []\nalgos = 'a'", "envs must contain at least one name"),
        ("envs = 'e'\nalgos = 'a'\nsteps = 1.5", "steps must be a whole number"),
        ("envs = 'e'\nalgos = 'a'\nseeds = 0", "seeds must be a whole number of at least 1"),
        ("envs = 'e'\nalgos = 'a'\nseeds = true", "seeds must be a whole number"),
        ("envs = 'e'\nalgos = 'a'\nseeds = '10:5'", r"seeds takes a count \(5\), a range \(5:10, without 10\)"),
        ("envs = 'e'\nalgos = 'a'\nseeds = '0'", "seeds must be at least one, not '0'"),
        ("envs = 'e'\nalgos = 'a'\nseeds = '0:99999999999'", "seeds must be at most 65536"),
        ("envs = 'e'\nalgos = 'a'\nruns = 3", r"\[\[runs\]\]"),
        ("envs = 'e'\nalgos = 'a'\noptions = 3", r"\[options\]"),
        ("envs = 'e'\nalgos = 'a'\n[options]\nx = []", "option x"),
        ("envs = 'e'\nalgos = 'a'\n[options]\nx = [1, 1]", "option x"),
        ("envs = 'e'\nalgos = 'a'\n[options]\nhidden_sizes = [16, 32]", r"write it as \[\[256, 256\]\]"),
        ("envs = 'e'\nalgos = 'a'\nseeds = 1000000000", "seeds must be at most 65536"),
        (f"envs = 'e'\nalgos = 'a'\nseeds = {'9' * 5000}", "can't be read"),
        (f"envs = 'e'\nalgos = {'[' * 5000}", "can't be read"),
        ("envs = 'e'\nalgos = 'a'\n[options]\n" + PRODUCT, "more than 10000 runs"),
        (
            "\n".join(f"[[runs]]\nenvs = 'e{n}'\nalgos = 'a'\noptions.x = {list(range(9999))}" for n in range(2)),
            "more than 10000",
        ),
        ("[[runs]]\nenvs = 'e'\nalgos = 'a'\nstep = 3", "unknown key 'step'"),
    ],
)
def test_invalid_grids_are_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, text)


def test_a_preset_is_overridden_by_the_values_of_its_block(tmp_path):
    text = "preset = 'strong'\nenvs = ['tabletop_organization', 'sawyer_door']\nalgos = 'naive'\n[options]\nlayer_norm = false\n"
    specs = read(tmp_path, text)
    assert [(spec.steps, len(spec.seeds)) for spec in specs] == [(2_500_000, 5), (4_000_000, 5)]
    assert specs[0].options == {"layer_norm": False, "timeout_bootstrap": True}
    [quick] = read(tmp_path, "envs = 'e'\nalgos = 'a'\npreset = 'quick'\nseeds = [7]\neval_every = 40\n")
    assert (quick.seeds, quick.steps, quick.eval_every) == ((7,), 170_000, 40)
    assert quick.options["hidden_sizes"] == [64, 64]


def read_space(tmp_path, text):
    path = tmp_path / "space.toml"
    path.write_text(text)
    return grid.read_space(path)


def test_a_space_is_a_run_distributions_and_a_sampler(tmp_path):
    text = SPACE + "options.y = 2\n"
    base, distributions, sampler = read_space(tmp_path, text)
    assert (base.options, distributions, sampler) == ({"y": 2}, {"x": {"uniform": [0, 1]}}, "tpe")
    assert read_space(tmp_path, "sampler = 'qmc'\n" + text)[2] == "qmc"
    quick = read_space(tmp_path, "preset = 'quick'\n" + text.replace("options.x", "options.hidden_sizes"))[0]
    assert quick.options.keys() == {"y", "batch_size", "timeout_bootstrap", "demo_share", "layer_norm", "learning_rate"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("'a'", "['a', 'b']"), "one task, one method"),
        (("options.x", "options.y = [1, 2]\noptions.x"), "one value of each option"),
        (("options.x = { uniform = [0, 1] }", ""), "needs options with a distribution"),
        (("options.x", "[[runs]]\noptions.x"), r"a search has no \[\[runs\]\]"),
        (("options.x", "samples = 3\noptions.x"), "samples is for a search"),
        (("options.x", "sampler = 'sobol'\noptions.x"), "unknown sampler 'sobol'; choose from tpe, random, qmc"),
        (("uniform = [0, 1]", "normal = [0, 1]"), "must be one of uniform, log_uniform, integers, choice"),
        (("uniform = [0, 1]", "uniform = [0, 1], choice = [1]"), "must be one of"),
        (("[0, 1]", "[1, 0]"), "uniform takes two numbers, the smaller one first"),
        (("[0, 1]", "[0, inf]"), "two numbers"),
        (("[0, 1]", "[0, true]"), "two numbers"),
        (("uniform", "log_uniform"), "both above 0"),
        (("uniform = [0, 1]", "integers = [1, 2.5]"), "both whole"),
        (("uniform = [0, 1]", "choice = []"), "a list of values"),
    ],
)
def test_invalid_spaces_are_refused(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        read_space(tmp_path, SPACE.replace(*change))


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere\.toml can't be read"):
        grid.read(tmp_path / "nowhere.toml")
