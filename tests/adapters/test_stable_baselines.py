"""An agent of Stable-Baselines3 learns tabletop organization through the gymnasium adapter."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).parent / "sb3_trains.py"


@pytest.mark.slow
@pytest.mark.skipif(not importlib.util.find_spec("stable_baselines3"), reason="pip install 'earl-jax[peers]'")
def test_sac_learns_from_a_lifetime():
    environment = {**os.environ, "PYTHONPATH": str(SCRIPT.parents[2]), "JAX_PLATFORMS": "cpu"}
    finished = subprocess.run([sys.executable, str(SCRIPT)], capture_output=True, text=True, env=environment)
    assert finished.returncode == 0, finished.stderr
    report = json.loads(finished.stdout.splitlines()[-1])
    assert np.isfinite(report["losses"]).all()
    assert report["dones"] == 0
    assert report["interventions"] >= 2
    assert report["trained"] > report["random"] + 50
