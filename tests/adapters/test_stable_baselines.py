"""An agent of Stable-Baselines3 gets better at tabletop organization through the gymnasium adapter."""

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
def test_sac_learns_from_a_life():
    environment = {**os.environ, "PYTHONPATH": str(SCRIPT.parents[2]), "JAX_PLATFORMS": "cpu"}
    found = subprocess.run([sys.executable, str(SCRIPT)], capture_output=True, text=True, env=environment)
    assert found.returncode == 0, found.stderr
    told = json.loads(found.stdout.splitlines()[-1])
    assert np.isfinite(told["losses"]).all()
    assert told["dones"] == 0
    assert told["interventions"] >= 2
    assert told["learnt"] > told["random"] + 50
