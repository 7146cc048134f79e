"""Lanes over several devices and hosts: fake CPU devices in a separate process, two processes as two hosts."""

import json
import os
from unittest.mock import Mock

import jax
import numpy as np
import pytest

import earl_jax
from earl_jax.runs.folder import RunFolder
from earl_jax.training.devices import lane_mesh
from tests.cli.process import run_code, start_two

FOUR_DEVICES = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=4"
COMPARE = """
import json
import numpy as np
import earl_jax
from earl_jax.training import devices, runner
tiny = dict(seeds=8, steps=80, eval_every=40, eval_episodes=2, hidden_sizes=[16], batch_size=16, random_steps=20)
single, four = (earl_jax.train("sawyer_door", "naive", devices=count, **tiny) for count in (1, 4))
error = max(float(np.abs(single.metrics[name] - four.metrics[name]).max()) for name in single.metrics)
problem, mesh = earl_jax.Problem(four.env, four.config.protocol(four.env)), devices.lane_mesh(4, 8)
method = devices.placed(four.method, mesh)
text = runner._advance.lower(problem, method, four.train_state, 20, False, mesh).compile().as_text()
words = ("all-reduce", "all-gather", "all-to-all", "collective", "reduce-scatter")
print(json.dumps({
    "error": error,
    "smallest_loss": float(np.abs(single.metrics["critic_loss"]).min()),
    "collectives": [word for word in words if word in text],
    "characters": len(text),
    "devices": len(four.train_state.lanes.phase.sharding.device_set),
}))
"""


@pytest.mark.slow
def test_four_devices_train_as_one_does_without_a_collective():
    report = json.loads(run_code(COMPARE, XLA_FLAGS=FOUR_DEVICES))
    assert report["devices"] == 4
    assert report["collectives"] == []
    assert report["characters"] > 10_000
    assert report["smallest_loss"] > 0
    assert report["error"] < 1e-4, "products over other numbers of lanes round differently"


@pytest.mark.parametrize(
    ("devices", "hosts", "message"),
    [
        (5, 1, r"5 devices requested, but 4 available \(cpu\)"),
        (3, 1, "8 lanes can't be divided over 3 devices: take 6 or 9 lanes, or 1 or 2 of the devices"),
        (2, 2, "the first 2 of 4 devices are not on all 2 hosts: request more"),
        (0, 1, r"devices must lie in \[1, "),
        *[(devices, 1, "devices must be a whole number") for devices in ("2", 1.0, True)],
    ],
)
def test_other_numbers_of_devices_than_there_are_or_fit_are_an_error(devices, hosts, message, monkeypatch):
    assert lane_mesh(None, 8) is None
    monkeypatch.setattr(jax, "devices", Mock(return_value=4 * jax.devices()))
    monkeypatch.setattr(jax, "process_count", lambda: hosts)
    with pytest.raises(ValueError, match=message):
        lane_mesh(devices, 8)


def run_on_two_hosts(*arguments, minutes=("60", "60")):
    hosts = start_two(*arguments, minutes=minutes)
    try:
        outputs = [host.communicate(timeout=120) for host in hosts]
    finally:
        for host in hosts:
            host.kill()
    assert [host.returncode for host in hosts] == [0, 0], outputs


@pytest.mark.slow
def test_two_hosts_write_one_run_and_resume_it(tmp_path):
    # The first part explores and the resumed part updates, so each program compiles once.
    options = {"hidden_sizes": [16, 16], "batch_size": 16, "random_steps": 40}
    pairs = [f"{name}={json.dumps(value)}" for name, value in options.items()]
    lengths = ["--seeds", "4", "--steps", "40", "--eval-every", "40", "--checkpoint-every", "40"]
    out = ["--out", str(tmp_path / "two_hosts"), "--set", *pairs]
    run_on_two_hosts("train", "tabletop_organization", "--algo", "naive", *lengths, *out)
    resume = ["resume", str(tmp_path / "two_hosts"), "--steps", "120"]
    run_on_two_hosts(*resume, minutes=("1e-9", "60"))  # the clock of the first host counts
    assert sorted(path.name for path in (tmp_path / "two_hosts/checkpoints").iterdir())[-1] == "000000080"
    run_on_two_hosts(*resume, minutes=("60", "1e-9"))
    one_host = tmp_path / "one_host"
    earl_jax.train("tabletop_organization", "naive", seeds=4, steps=120, eval_every=40, out=one_host, **options)
    table, expected = (RunFolder.open(path).table() for path in (tmp_path / "two_hosts", one_host))
    assert table.steps.tolist() == expected.steps.tolist() == [40, 80, 120]
    for name, values in expected.metrics.items():
        np.testing.assert_allclose(table.metrics[name], values, rtol=1e-4, atol=1e-5, err_msg=name)
