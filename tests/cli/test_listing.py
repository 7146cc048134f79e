"""Tests of `earl-jax list`: what it reads from source is what the classes are, it fits a terminal, and loads no jax."""

import dataclasses
import json
import os
import subprocess
import sys

import numpy as np
import pytest

import earl_jax
from earl_jax import algos, envs
from earl_jax.cli import catalog
from earl_jax.cli.class_source import class_at
from tests.cli.process import run
from tests.conftest import write_files

PLUGIN = '''
import earl_jax
from theirs.tasks import Meadow
from earl_jax.algos.naive import Naive

class Patient(Naive):
    """Wait. Source: Lamb et al. 2025.

    `patience` steps pass first.
    """

    patience: int = 3
    name = "patient"
'''
MEADOW = '''
import dataclasses
from typing import ClassVar
from earl_jax import Env
raise RuntimeError("listing does not run this")

@dataclasses.dataclass(frozen=True)
class Meadow(Env):
    """Cross a meadow: `obs [5]` = sheep 3, goal 2. `grass` is its height."""

    grass: float = 2 * 0.25
    name: ClassVar[str] = "meadow"
    action_size: ClassVar[int] = 1
'''


@pytest.fixture(scope="module")
def everything():
    return catalog.catalog()


@pytest.mark.parametrize("name", envs.list_envs())
def test_a_task_is_described_as_its_object_is(everything, name):
    env, described = envs.make(name), everything["tasks"][name]
    for key in ("obs_size", "goal_size", "action_size", "reward_type", "train_horizon", "eval_horizon", "goal_change"):
        assert described[key] == getattr(env, key), key
    assert described["demonstrations"] == list(env.demo_directions)
    assert described["engines"] == (["mjx", "warp", "c"] if isinstance(env, envs.MujocoEnv) else [])
    assert described["reward_types"] == ["sparse", "dense"]
    assert described["summary"] == env.summary
    assert defaults(described) == {field.name: field.default for field in dataclasses.fields(env)}


@pytest.mark.parametrize("name", algos.list_algos())
def test_a_method_is_described_as_its_object_is(everything, name):
    method, described = algos.make_algo(name), everything["methods"][name]
    assert described["needs_demonstrations"] is method.needs_demos
    assert described["uses_demonstrations"] == list(method.demo_directions)
    assert described["year"] >= 1980
    assert str(described["year"]) in described["source"]
    fields = {field.name: field.default for field in dataclasses.fields(method) if field.name != "sac"}
    assert defaults(described) == fields


def test_the_options_of_the_learner_have_their_defaults_and_intervals(everything):
    fields = dataclasses.fields(algos.SAC)
    plain = {field.name: np.asarray(field.default).tolist() for field in fields if field.default is not None}
    assert {
        name: value for name, value in defaults({"options": everything["learner"]}).items() if value is not None
    } == plain
    intervals = {field.name: field.metadata["interval"].text for field in fields if "interval" in field.metadata}
    assert {name: option["valid"] for name, option in everything["learner"].items() if option["valid"]} == intervals


def test_every_option_has_a_meaning(everything):
    groups = [*everything["tasks"].values(), *everything["methods"].values(), {"options": everything["learner"]}]
    options = [(name, option["meaning"]) for group in groups for name, option in group["options"].items()]
    assert [name for name, meaning in options if len(meaning) < 10] == []
    assert len(options) > 60


@pytest.mark.parametrize("arguments", [[], ["sawyer_peg"], ["vaprl"]])
def test_the_text_fits_eighty_columns_and_names_the_options(arguments, everything):
    code, out, _ = run("list", *arguments)
    assert code == 0
    assert max(map(len, out.splitlines())) <= 80
    names = (
        ["reset_at_goal", "sawyer_peg"]
        if arguments != ["vaprl"]
        else ["epsilon=0.1", "discount=0.99", "Sharma et al. 2021"]
    )
    assert all(name in out for name in names)


def test_json_describes_one_name_or_all():
    everything = json.loads(run("list", "--json")[1])
    assert everything["envs"] == envs.list_envs()
    assert json.loads(run("list", "sawyer_door", "--json")[1]) == everything["tasks"]["sawyer_door"]
    fbrl = json.loads(run("list", "fbrl", "--json")[1])
    assert fbrl == {**everything["methods"]["fbrl"], "learner": everything["learner"]}
    code, _, err = run("list", "ppo")
    assert code == 2
    assert "no task, method or preset 'ppo'; choose from cheetah_run" in err
    assert json.loads(run("list", "quick", "--json")[1]) == everything["presets"]["quick"]


def test_trained_policies_that_ship_are_listed(everything):
    shipped = earl_jax.list_pretrained()
    assert shipped == {name: list(task["policies"]) for name, task in everything["tasks"].items() if task["policies"]}
    info, policy = (
        earl_jax.pretrained_info("sawyer_door", "fbrl"),
        everything["methods"]["fbrl"]["policies"]["sawyer_door"],
    )
    assert policy == everything["tasks"]["sawyer_door"]["policies"]["fbrl"]
    assert {**{key: info[key] for key in policy if key != "options"}, "options": {"precision": "bf16"}} == policy
    lines = run("list", "sawyer_door")[1].splitlines()
    assert "trained policies that ship (earl_jax.pretrained('sawyer_door', METHOD)):" in lines
    where = next(number for number, line in enumerate(lines) if line.startswith("  fbrl: of a run of 3,300,000 steps"))
    assert lines[where + 1].startswith("      seeds 3, 4; success 1.0, 1.0; return 211.86")
    assert "    Trained policies: sawyer_door, tabletop_organization." in run("list")[1].splitlines()
    assert "trained policies" not in run("list", "fish_swim")[1]


def test_presets_are_listed_with_their_lengths_and_options():
    out = run("list")[1]
    assert "paper           5   published        10" in out
    assert "layer_norm=true, timeout_bootstrap=true" in " ".join(out.split())
    lines = run("list", "strong")[1].splitlines()
    assert {"steps                 published", "layer_norm            true"} <= set(lines)


def test_listing_loads_no_jax_and_no_numpy():
    code = "import sys; from earl_jax.cli import main; main(['list']); print([m for m in ('jax', 'numpy') if m in sys.modules])"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.splitlines()[-1] == "[]"


def test_a_reader_that_leaves_early_ends_the_command_quietly():
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "earl_jax.cli", "list"]
    process = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (process.returncode, process.stderr) == (1, "")


def test_tasks_and_methods_of_installed_packages_are_read_and_not_run(tmp_path, monkeypatch):
    points = "[earl_jax.envs]\nmeadow = theirs:Meadow\nfog = nowhere:Fog\n[earl_jax.algos]\npatient = theirs:Patient\n"
    files = {
        "theirs-0.3.dist-info/METADATA": "Metadata-Version: 2.1\nName: theirs\nVersion: 0.3\n",
        "theirs-0.3.dist-info/entry_points.txt": points,
        "theirs/__init__.py": PLUGIN,
        "theirs/tasks.py": MEADOW,
    }
    write_files(files, tmp_path / "site")
    monkeypatch.syspath_prepend(tmp_path / "site")
    listed = catalog.catalog()
    meadow, patient = listed["tasks"]["meadow"], listed["methods"]["patient"]
    assert (meadow["obs_size"], meadow["goal_size"], meadow["action_size"]) == (5, 2, 1)
    assert meadow["package"] == "theirs 0.3"
    assert meadow["options"]["grass"] == {
        "type": "float",
        "default": 0.5,
        "valid": None,
        "meaning": "`grass` is its height.",
    }
    assert (patient["year"], patient["source"]) == (2025, "Lamb et al. 2025")
    assert set(patient["options"]) == {"episode_length", "global_clock", "patience"}
    assert listed["tasks"]["fog"]["error"] == "no source found for nowhere:Fog"
    text = run("list")[1]
    assert "From theirs 0.3." in text
    assert "no source found for nowhere:Fog" in text


def test_a_value_that_source_alone_does_not_give_is_shown_as_written(tmp_path, monkeypatch):
    source = (
        "import os\nclass Task:\n    seconds: float = os.times()[0]\n    late: int = LATER + 1\n    loop: int = LOOP\n"
    )
    source += "LATER = 4\nLOOP = LOOP\n"
    write_files({"written/__init__.py": source}, tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    task = class_at("written:Task")
    assert task is not None
    assert {name: field.value for name, field in task.fields().items()} == {
        "seconds": "os.times()[0]",
        "late": 5,
        "loop": "LOOP",
    }
    assert class_at("written:Nothing") is None


def defaults(described):
    return {name: option["default"] for name, option in described["options"].items()}
