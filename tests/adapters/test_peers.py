"""Libraries that train through the adapters, in processes of their own, and the snippets of docs/adapters.md."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.cli.process import ENVIRONMENT, run_code

ROOT = Path(__file__).parents[2]
OLD = ROOT / ".cache" / "brax"
NEEDS = ["jax==0.9.2", "brax==0.14.2", "flax==0.12.6", "optax", "scipy", "mujoco==4.0.0", "mujoco-mjx==3.17.0"]
PAGE = (ROOT / "docs" / "adapters.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.fixture(scope="module")
def python():
    """A Python with a jax that brax's trainers support: $EARL_JAX_BRAX_PYTHON, or installed once from the index."""
    if "EARL_JAX_BRAX_PYTHON" in os.environ:
        return os.environ["EARL_JAX_BRAX_PYTHON"]
    path, stamp = OLD / "bin" / "python", OLD / "installed"
    if not stamp.is_file():
        subprocess.run([sys.executable, "-m", "venv", "--clear", str(OLD)], check=True)
        pip = [str(path), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        installation = subprocess.run([*pip, *NEEDS], capture_output=True, text=True)
        if installation.returncode:
            pytest.skip(f"no jax 0.9.2: set EARL_JAX_BRAX_PYTHON ({installation.stderr.strip().splitlines()[-1]})")
        stamp.touch()
    return str(path)


@pytest.mark.slow
def test_braxs_own_sac_learns_from_a_lifetime(python):
    command, env = [python, str(ROOT / "tests/adapters/brax_trains.py")], dict(ENVIRONMENT)
    env.pop("XLA_FLAGS", None)  # another jax than ours does not know all flags of the tests
    finished = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300)
    assert finished.returncode == 0, finished.stderr
    report = json.loads(finished.stdout.splitlines()[-1])
    before, after = report["rows"][0], report["rows"][-1]
    assert report["jax"].startswith("0.9.")
    assert after["step"] >= 4000
    assert np.isfinite([after[f"training/{name}_loss"] for name in ("actor", "critic", "alpha")]).all()
    assert after["eval/episode_reward"] > before["eval/episode_reward"] + 200


@pytest.mark.slow
@pytest.mark.parametrize("snippet", SNIPPETS)
def test_a_snippet_of_the_page_runs_and_prints(snippet):
    if "stable_baselines3" in snippet and not importlib.util.find_spec("stable_baselines3"):
        pytest.skip("the learners of other libraries need the extra peers")
    assert run_code(snippet)


def test_the_page_lists_the_versions_that_braxs_trainers_are_tested_with():
    assert f"old/bin/pip install {' '.join(NEEDS)}\n" in PAGE
