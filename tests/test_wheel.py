"""The wheel holds everything: assets inside, the command installed, usable outside the checkout."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    built = subprocess.run(command, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    return next(out.glob("*.whl"))


def test_assets_travel_inside(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    for path in (ROOT / "assets").rglob("*"):
        if path.is_file():
            assert f"earl_jax/assets/{path.relative_to(ROOT / 'assets')}" in names
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/", "assets/"))]


def test_it_works_outside_the_checkout(wheel, tmp_path):
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    code = (
        "import earl_jax, earl_jax.assets as assets; env = earl_jax.make('tabletop_organization');"
        "print(earl_jax.__file__, assets.root(), len(assets.demos(env.name, 'forward').ends), earl_jax.list_algos())"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site"), "JAX_PLATFORMS": "cpu"}
    found = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert str(tmp_path / "site" / "earl_jax" / "assets") in found.stdout
    assert "1241" in found.stdout
