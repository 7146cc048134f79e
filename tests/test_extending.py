"""The two packages of docs/extending.md, installed and used as the page says."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import CACHE, write_files

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "extending.md").read_text()
FILES = dict(re.findall(r"\*\*`(\S+)`:?\*\*\n\n```\w+\n(.*?)```", PAGE, flags=re.DOTALL))
PENDULUM = {name.removeprefix("earl-pendulum/"): text for name, text in FILES.items() if "pendulum" in name}
PASTURE = {name: text for name, text in FILES.items() if "pendulum" not in name}
SNIPPETS = [
    code for code in re.findall(r"```py(?:thon)?\n(.*?)```", PAGE, flags=re.DOTALL) if code not in FILES.values()
]
REGISTERED, OBJECTS, DEMOS = SNIPPETS
TINY = ["hidden_sizes=[16,16]", "batch_size=16", "random_steps=20"]
LENGTHS = ["--seeds", "2", "--steps", "40", "--eval-every", "40", "--eval-episodes", "2", "--checkpoint-every", "40"]

USE_PASTURE = """
from pathlib import Path
main(["list", "--json"])
main(["train", "pasture", "--algo", "detour", *LENGTHS, "--out", "run", "--set", "home_share=0.8", "fear=0.4", *TINY])
main(["evaluate", "run", "--episodes", "2"])
main(["resume", "run", "--steps", "80"])
main(["train", "pasture", "--algo", "subsets", *LENGTHS, "--out", "subsets", "--set", "reward_type=dense", *TINY])
learner = ["--learner", "ddpg", "--set", "noise=0.2", *TINY]
main(["train", "pasture", "--algo", "detour", *LENGTHS, "--out", "ddpg", *learner])
main(["evaluate", "ddpg", "--episodes", "2"])
exec(DEMOS)
demos = f"demo_file={Path('pasture.npz').resolve()}"
main(["train", "pasture", "--algo", "vaprl", *LENGTHS, "--out", "vaprl", "--set", demos, *TINY])
"""
USE_PENDULUM = """
for engine in ("c", "mjx"):
    run = ["--engine", engine, "--out", engine, "--set", *TINY]
    main(["train", "pendulum_hold", "--algo", "fbrl", *LENGTHS, *run])
main(["evaluate", "c", "--episodes", "2", "--engine", "mjx"])
import jax, earl_jax
from earl_jax.metrics.deployed import deployed
env = earl_jax.make("pendulum_hold", engine="c")
print(deployed(env, env.demonstrations.expert, jax.random.key(0), env.eval_horizon, 10))
"""
CHECK_CONTRACT = """
import pytest
raise SystemExit(pytest.main([CONTRACT, "-k", "{name}", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]))
"""


def use_package(code, name, folder):
    """Return what `code` prints in a process with the package in `folder`, followed by the contract tests of task `name`."""
    given = {"TINY": TINY, "LENGTHS": LENGTHS, "DEMOS": DEMOS, "CONTRACT": str(ROOT / "tests/envs/test_contract.py")}
    constants = "".join(f"{key} = {value!r}\n" for key, value in given.items())
    code = f"{constants}from earl_jax.cli import main\n{code}{CHECK_CONTRACT.format(name=name)}"
    environment = {**os.environ, "PYTHONPATH": f"{folder / 'site'}:{ROOT}", "JAX_COMPILATION_CACHE_DIR": str(CACHE)}
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=570)
    assert result.returncode == 0, result.stdout + result.stderr
    assert re.search(r"\d+ passed", result.stdout)
    return result.stdout


def install(files, folder):
    """Install the package of `files` into `folder/site`."""
    write_files(files, folder / "package")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", str(folder / "site"), str(folder / "package")], check=True)


@pytest.mark.slow
def test_the_kinematic_package_is_installed_listed_trained_evaluated_and_resumed(tmp_path):
    install(PASTURE, tmp_path)
    listed = use_package(USE_PASTURE, "pasture", tmp_path).splitlines()[0]
    assert '"pasture"' in listed
    assert '"detour"' in listed
    config = (tmp_path / "run" / "config.json").read_text()
    assert '"home_share": 0.8' in config
    assert '"fear": 0.4' in config
    assert len((tmp_path / "run" / "metrics.csv").read_text().splitlines()) == 1 + 2 * 2
    assert len((tmp_path / "subsets" / "metrics.csv").read_text().splitlines()) == 1 + 2


@pytest.mark.slow
def test_the_mujoco_package_is_installed_and_trained_on_c_and_mjx(tmp_path):
    install(PENDULUM, tmp_path)
    output = use_package(USE_PENDULUM, "pendulum_hold", tmp_path)
    assert re.search(r"'deployed/success': Array\(1\.?0?,", output), "the expert reaches both goals"
    for engine in ("c", "mjx"):
        assert f'"engine": "{engine}"' in (tmp_path / engine / "config.json").read_text()
        assert len((tmp_path / engine / "metrics.csv").read_text().splitlines()) == 1 + 2


@pytest.fixture
def importable(tmp_path, monkeypatch, registries):
    """Make the classes of the kinematic package importable, without entry points."""
    write_files(PASTURE, tmp_path)
    monkeypatch.syspath_prepend(tmp_path / "src")
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_registered_classes_train_by_name(importable):
    names = {}
    exec(REGISTERED, names)
    assert names["result"].method.home_share.tolist() == pytest.approx([0.2, 0.8])
    assert names["result"].metrics["deployed/success"].shape == (2, 2)


@pytest.mark.slow
def test_objects_train_and_resume_without_a_registered_name(importable, tmp_path):
    exec(OBJECTS, {})
    rows = (tmp_path / "runs/objects/metrics.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 4
