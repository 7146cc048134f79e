"""The package: what importing it loads, its public names, its wheel outside the checkout, and its size."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import earl_jax
from tests.cli.process import run_code

ROOT = Path(__file__).parents[1]
MOST_LINES = 300
MOST_BYTES = 25 * 2**20
USE = """
import sys, earl_jax
loaded = lambda *names: [name for name in names if name in sys.modules]
assert loaded("brax", "gymnasium", "matplotlib", "mujoco", "orbax", "flax", "jax") == []
env = earl_jax.envs.make("tabletop_organization")
assert loaded("brax", "gymnasium", "matplotlib", "mujoco") == []
from earl_jax import assets
print(earl_jax.__file__, assets.root(), len(assets.demos(env.name, "forward").ends), earl_jax.list_algos())
"""
SMOKE = """
set -eu
earl-jax list --json
earl-jax train tabletop_organization --algo fbrl --seeds 2 --steps 200 --eval-every 100 --eval-episodes 2 --out run \
  --log tensorboard --set 'hidden_sizes=[16,16]' batch_size=16 random_steps=20
earl-jax resume run --steps 400
earl-jax evaluate run --episodes 2 --json
earl-jax table run --out table.md
earl-jax plot run --out curves.png
earl-jax demos tabletop_organization --out demos.npz
earl-jax render run --out run/video.mp4 --steps 20
earl-jax render sawyer_door --out door.png --steps 20
earl-jax report run --out report.html
python -c "import gymnasium as g; print(g.make('earl_jax.adapters.gymnasium:earl_jax/SawyerDoor-v0').reset(seed=0)[0].shape)"
"""
"""The commands that a new user would try first, in their own folder."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    process = subprocess.run(command, capture_output=True, text=True)
    assert process.returncode == 0, process.stdout + process.stderr
    return next(out.glob("*.whl"))


def test_wheel_contains_every_asset(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    for path in (ROOT / "assets").rglob("*"):
        if path.is_file():
            assert f"earl_jax/assets/{path.relative_to(ROOT / 'assets')}" in names
    assert "earl_jax/py.typed" in names
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/", "assets/", "examples/"))]
    assert not [name for name in names if "cfbrl" in name and not name.startswith("earl_jax/assets/")]


def test_the_wheel_works_outside_the_checkout_and_imports_load_no_simulator_or_learner(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    printed = run_code(USE, cwd=tmp_path, PYTHONPATH=str(tmp_path / "site"))
    assert str(tmp_path / "site" / "earl_jax" / "assets") in printed
    assert "1241" in printed


@pytest.mark.slow
def test_every_command_works_in_a_clean_environment(wheel, tmp_path):
    venv, work = tmp_path / "venv", tmp_path / "work"
    subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True)
    pip = [str(venv / "bin/python"), "-m", "pip", "install", "--quiet", "-c", str(ROOT / "requirements.lock")]
    subprocess.run([*pip, f"{wheel}[plot,render,report,tensorboard]"], check=True)
    work.mkdir()
    env = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "XLA", "VIRTUAL"))}
    env |= {"PATH": f"{venv / 'bin'}:{os.environ['PATH']}", "JAX_PLATFORMS": "cpu"}
    env |= {"EARL_JAX_CACHE": str(tmp_path / "programs")}
    process = subprocess.run(["bash", "-c", SMOKE], cwd=work, env=env, capture_output=True, text=True)
    assert process.returncode == 0, process.stdout + process.stderr
    assert "(14,)" in process.stdout
    pictures = ["curves.png", "door.png", "run/video.mp4"]
    outputs = ["run/metrics.csv", "run/tensorboard", "table.md", "demos.npz", "report.html", *pictures]
    assert [name for name in outputs if not (work / name).exists()] == []
    assert "data:video/mp4" in (work / "report.html").read_text()


def test_the_package_lists_its_public_names_and_has_no_others():
    """tests/test_site.py compares them with those of the reference."""
    assert set(earl_jax.__all__) <= set(dir(earl_jax))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = earl_jax.nonsense


@pytest.mark.skipif(shutil.which("git") is None or not (ROOT / ".git").exists(), reason="needs git and its repository")
def test_the_tracked_files_have_at_most_25_mib_and_python_files_300_lines():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [path for name in listed.split("\0") if name and (path := ROOT / name).is_file()]
    sizes = {path: path.stat().st_size for path in files}
    largest = ", ".join(str(path.relative_to(ROOT)) for path in sorted(sizes, key=sizes.__getitem__)[-5:])
    assert sum(sizes.values()) <= MOST_BYTES, f"{sum(sizes.values()):,} bytes; the largest are {largest}"
    code = [path for path in files if path.suffix == ".py"]
    assert [path for path in code if len(path.read_text().splitlines()) > MOST_LINES] == []
