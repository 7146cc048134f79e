"""Tests of `earl-jax list`: its catalog is what the classes are, it fits a terminal, and it loads no jax."""

import json

import pytest

import earl_jax
from earl_jax.cli import descriptions, listing
from tests.cli.process import one_line, run, run_code, succeed
from tests.conftest import write_files

LIST_OWN = """
import sys
from importlib import metadata
from earl_jax.cli import main
metadata.entry_points = lambda **group: []  # classes of other packages are imported
main(["list"])
print({"jax", "numpy"} & set(sys.modules))
"""
THEIRS = '''
import dataclasses
from earl_jax.algos.naive import Naive
from earl_jax.envs.tabletop import TabletopOrganization

@dataclasses.dataclass(frozen=True)
class Meadow(TabletopOrganization):
    """Cross a meadow. `grass` is its height."""

    grass: float = 2 * 0.25
    name = "meadow"
    summary = ""

class Patient(Naive):
    """Wait. Source: Lamb et al. 2025.

    `patience` steps pass first.
    """

    patience: int = 3
    name = "patient"
'''


@pytest.fixture(scope="module")
def everything():
    return listing.describe_all()


def test_the_catalog_is_what_the_classes_are():
    assert json.loads(descriptions.CATALOG.read_text()) == descriptions.catalog(), "run `make catalog`"


def test_every_name_is_described_with_the_meaning_of_its_options(everything):
    groups = [group for kind in ("tasks", "methods", "learners") for group in everything[kind].values()]
    groups.append({"options": everything["shared"]})
    assert [group["error"] for group in groups if "error" in group] == []
    options = [(name, option["meaning"]) for group in groups for name, option in group["options"].items()]
    assert [name for name, meaning in options if len(meaning) < 10] == []
    assert len(options) > 60
    assert all(str(method["year"]) in method["source"] for method in everything["methods"].values())


@pytest.mark.parametrize(
    ("arguments", "texts"),
    [
        ([], ["sawyer_peg             A robot arm", "fbrl        Alternate", "sac, td3", "strong", "earl-jax list NAME"]),
        (["sawyer_peg"], ["reset_at_goal", "observation size"]),
        (["sawyer_door"], ["(earl_jax.pretrained('sawyer_door', METHOD))", "seeds 3, 4; success 1, 1; return 211.86, 206.28\n"]),
        (["vaprl"], ["epsilon=0.1", "cloning=null  (float | None;", "discount=0.99  (float; in [0, 1))", "Sharma et al. 2021"]),
        (["td3"], ["policy_delay=2", "discount=0.99", "Fujimoto, van Hoof and Meger 2018"]),
        (["quick"], ["steps                 170,000\n", "learning_rate         0.001\n"]),
        (["strong"], ["steps                 published\n", "layer_norm            true\n"]),
    ],
)  # fmt: skip
def test_the_text_fits_eighty_columns_and_that_of_all_names_a_screen(arguments, texts):
    out = succeed("list", *arguments)
    assert max(map(len, out.splitlines())) <= 80
    assert arguments or len(out.splitlines()) < 24
    assert [text for text in texts if text not in out] == []


@pytest.mark.parametrize("length", [24, 90])
def test_a_long_name_stays_apart_from_its_summary(length):
    name = "m" * length
    described = {name: {"name": name, "summary": "Wait."}}
    everything = {"tasks": described, "methods": described, "learners": {}, "presets": {}}
    assert f"\nmethods  {name}  Wait.\n" in listing._overview(everything)


def test_json_describes_one_name_or_all():
    everything = json.loads(succeed("list", "--json"))
    assert everything["envs"] == list(everything["tasks"]) == earl_jax.list_envs()
    assert everything["algos"] == list(everything["methods"]) == earl_jax.list_algos()
    assert json.loads(succeed("list", "sawyer_door", "--json")) == everything["tasks"]["sawyer_door"]
    fbrl = json.loads(succeed("list", "fbrl", "--json"))
    learner = {**everything["shared"], **everything["learners"]["sac"]["options"]}
    assert fbrl == {**everything["methods"]["fbrl"], "learner": learner}
    assert json.loads(succeed("list", "quick", "--json")) == everything["presets"]["quick"]
    one_line(run("list", "ppo"), "no task, method, learner or preset 'ppo'; choose from cheetah_run")


def test_trained_policies_that_ship_are_listed(everything):
    shipped = {name: list(task["policies"]) for name, task in everything["tasks"].items() if task["policies"]}
    assert shipped == earl_jax.list_pretrained()
    assert "trained policies" not in succeed("list", "fish_swim")


def test_listing_loads_no_jax_and_no_numpy():
    assert run_code(LIST_OWN).splitlines()[-1] == "set()"


def test_tasks_and_methods_of_installed_packages_are_listed(tmp_path, monkeypatch):
    points = "[earl_jax.envs]\nmeadow = listed:Meadow\nfog = nowhere:Fog\n[earl_jax.algos]\npatient = listed:Patient\n"
    files = {
        "theirs-0.3.dist-info/METADATA": "Metadata-Version: 2.1\nName: theirs\nVersion: 0.3\n",
        "theirs-0.3.dist-info/entry_points.txt": points,
        "listed/__init__.py": THEIRS,
    }
    write_files(files, tmp_path / "site")
    monkeypatch.syspath_prepend(tmp_path / "site")
    meadow, patient = listing.describe("task", "meadow"), listing.describe("method", "patient")
    assert (meadow["observation_size"], meadow["package"], meadow["summary"]) == (12, "theirs 0.3", "Cross a meadow.")
    grass = {"type": "float", "default": 0.5, "valid": None, "meaning": "`grass` is its height."}
    assert meadow["options"]["grass"] == grass
    assert meadow["options"]["reward_type"]["valid"] == ["sparse", "dense"]
    assert (patient["year"], patient["source"]) == (2025, "Lamb et al. 2025")
    assert set(patient["options"]) == {"episode_length", "global_clock", "patience"}
    text = succeed("list")
    assert "meadow                 Cross a meadow. From theirs 0.3.\n" in text
    assert "patient     Wait. From theirs 0.3.\n" in text
    assert "'fog' of theirs 0.3 cannot be loaded:..." in text
    assert "ModuleNotFoundError: No module named 'nowhere'" in " ".join(succeed("list", "fog").split())
