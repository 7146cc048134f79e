"""The package examples/pasture, installed and used as docs/extending.md says, and the code of that page."""

import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import earl_jax
from tests.cli.process import run_code

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "examples" / "pasture"
PAGE = (ROOT / "docs" / "extending.md").read_text()
SOURCES = [path.read_text() for path in [PACKAGE / "pyproject.toml", *(PACKAGE / "earl_pasture").glob("*.py")]]
BLOCKS = re.findall(r"```(?:python|toml)\n(.*?)```", PAGE, flags=re.DOTALL)
SNIPPETS = [code for code in BLOCKS if not any(" ".join(code.split()) in " ".join(text.split()) for text in SOURCES)]
DEMOS, STEPPING, OBJECTS = SNIPPETS
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
import pytest
from earl_pasture.ddpg import DDPG
for option in {"utd": 2}, {"cloning": 0.5}:
    with pytest.raises(ValueError, match="ddpg has neither utd nor cloning"):
        DDPG(**option)
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


def use_package(code, name, folder, site):
    """Return what `code` prints in a process with the package in `site`, followed by the contract tests of task `name`."""
    given = {"TINY": TINY, "LENGTHS": LENGTHS, "DEMOS": DEMOS, "CONTRACT": str(ROOT / "tests/envs/test_contract.py")}
    constants = "".join(f"{key} = {value!r}\n" for key, value in given.items())
    code = f"{constants}from earl_jax.cli import main\n{code}{CHECK_CONTRACT.format(name=name)}"
    printed = run_code(code, cwd=folder, PYTHONPATH=f"{site}:{ROOT}")
    assert re.search(r"\d+ passed", printed)
    return printed


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder into which the package is installed."""
    folder = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", str(folder), str(PACKAGE)], check=True)
    return folder


@pytest.mark.slow
def test_the_kinematic_task_is_installed_listed_trained_evaluated_and_resumed(tmp_path, site):
    listed = use_package(USE_PASTURE, "pasture", tmp_path, site).splitlines()[0]
    assert '"pasture"' in listed
    assert '"detour"' in listed
    config = (tmp_path / "run" / "config.json").read_text()
    assert '"home_share": 0.8' in config
    assert '"fear": 0.4' in config
    assert len((tmp_path / "run" / "metrics.csv").read_text().splitlines()) == 1 + 2 * 2
    assert len((tmp_path / "subsets" / "metrics.csv").read_text().splitlines()) == 1 + 2


@pytest.mark.slow
def test_the_mujoco_task_is_installed_and_trained_on_c_and_mjx(tmp_path, site):
    output = use_package(USE_PENDULUM, "pendulum_hold", tmp_path, site)
    assert re.search(r"'deployed/success': Array\(1\.?0?,", output), "the expert reaches both goals"
    for engine in ("c", "mjx"):
        assert f'"engine": "{engine}"' in (tmp_path / engine / "config.json").read_text()
        assert len((tmp_path / engine / "metrics.csv").read_text().splitlines()) == 1 + 2


@pytest.mark.slow
def test_objects_train_and_resume_and_registered_classes_train_by_name(tmp_path, monkeypatch, registries):
    """The classes are importable, without entry points."""
    monkeypatch.syspath_prepend(PACKAGE)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(OBJECTS, names)
    rows = (tmp_path / "runs/objects/metrics.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 4
    assert names["result"].method.home_share.tolist() == pytest.approx([0.2, 0.8])
    assert names["result"].metrics["deployed/success"].shape == (2, 2)


@pytest.mark.slow
def test_a_policy_steps_a_task_in_a_scan():
    exec(STEPPING, {})


@pytest.mark.slow
def test_a_kinematic_task_has_derivatives_in_positions_and_none_in_decisions():
    env = earl_jax.make("tabletop_organization", reward_type="dense")
    start = env.reset(jax.random.key(0))

    def total(actions):
        def step(state, action):
            state = env.step(state, action)
            return state, state.reward

        return jax.lax.scan(step, start, actions)[1].sum()

    gradient = jax.jit(jax.grad(total))(jnp.full((10, env.action_size), 0.1))
    assert jnp.abs(gradient[:, :2]).max() > 0
    assert (gradient[:, 2] == 0).all()


def test_the_page_has_the_code_of_the_package():
    assert len(BLOCKS) - len(SNIPPETS) >= 5
    assert all("earl_jax." in code for code in SNIPPETS), "other blocks are of the package"
    assert all(
        f"../examples/pasture/earl_pasture/{path.name}" in PAGE for path in PACKAGE.glob("earl_pasture/[!_]*.py")
    )
