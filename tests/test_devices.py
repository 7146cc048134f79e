"""Lanes over several devices and hosts: fake CPU devices in a process of their own, two processes as two hosts."""

import json
import os
import socket
import subprocess
import sys

import numpy as np
import pytest

import earl_jax
from earl_jax.runs.folder import RunFolder
from earl_jax.runs.hosts import join_hosts, lane_mesh
from tests.conftest import CACHE

FOUR = {**os.environ, "XLA_FLAGS": f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=4"}
SETTING = """
import json, sys
import jax
import numpy as np
import earl_jax
from earl_jax import devices, program
from earl_jax.algos.life import Loop
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
tiny = dict(seeds=8, steps=80, eval_every=40, eval_episodes=2, hidden_sizes=[16, 16], batch_size=16, random_steps=20)
"""
EQUAL = """
one, four = (earl_jax.train("sawyer_door", "naive", devices=count, **tiny) for count in (1, 4))
apart = max(float(np.abs(one.metrics[name] - four.metrics[name]).max()) for name in one.metrics)
loop, mesh = Loop(four.env, four.experiment.protocol(four.env)), devices.lane_mesh(4, 8)
text = program._advance.lower(loop, devices.placed(four.method, mesh), four.lives, 20, False, mesh).compile().as_text()
words = ("all-reduce", "all-gather", "all-to-all", "collective", "reduce-scatter")
print(json.dumps({
    "apart": apart, "moved": float(np.abs(one.metrics["critic_loss"]).min()), "found": [word for word in words if word in text],
    "long": len(text) > 10_000, "devices": len(four.lives.lanes.phase.sharding.device_set),
}))
"""


def told(script):
    command = [sys.executable, "-c", SETTING + script, str(CACHE)]
    result = subprocess.run(command, env=FOUR, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr[-2000:]
    return json.loads(result.stdout.splitlines()[-1])


def test_four_devices_live_the_lives_of_one_without_a_collective():
    said = told(EQUAL)
    assert (said["devices"], said["found"], said["long"]) == (4, [], True)
    assert said["moved"] > 0
    assert said["apart"] < 1e-4, "products over other numbers of lanes round differently"


def test_what_does_not_fit_the_devices_says_what_would():
    with pytest.raises(ValueError, match=r"2 devices asked for, and there are 1 \(cpu\)"):
        lane_mesh(2, 8)
    assert lane_mesh(None, 8) is None
    said = told("""
try:
    earl_jax.train("tabletop_organization", "naive", devices=3, **tiny)
except ValueError as error:
    print(json.dumps(str(error)))
""")
    assert said == "8 lanes don't divide over 3 devices: take 6 or 9 lanes, or one of 1, 2 devices"


def test_hosts_are_asked_for_in_one_of_two_ways():
    join_hosts(None)
    with pytest.raises(ValueError, match="--hosts takes auto or ADDRESS:PORT,HOSTS,NUMBER, not 'two'"):
        join_hosts("two")


def free_port():
    with socket.socket() as listener:
        listener.bind(("localhost", 0))
        return listener.getsockname()[1]


def on_two_hosts(*arguments):
    address = f"localhost:{free_port()}"
    env = {**os.environ, "EARL_JAX_CACHE": str(CACHE), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2"}
    hosts = [
        subprocess.Popen(
            [sys.executable, "-m", "earl_jax.cli.main", *arguments, "--hosts", f"{address},2,{number}"],
            env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )
        for number in range(2)
    ]  # fmt: skip
    try:
        said = [host.communicate(timeout=120)[0] for host in hosts]
    finally:
        for host in hosts:
            host.kill()
    assert [host.returncode for host in hosts] == [0, 0], said


@pytest.mark.slow
def test_two_hosts_write_one_run_and_go_on_with_it(tmp_path):
    # Explored first, learnt after the resume: each program compiles once.
    options = {"hidden_sizes": [16, 16], "batch_size": 16, "random_steps": 40}
    pairs = [f"{name}={json.dumps(value)}" for name, value in options.items()]
    lengths = ["--seeds", "4", "--steps", "40", "--eval-every", "40", "--checkpoint-every", "40"]
    out = ["--out", str(tmp_path / "two"), "--set", *pairs]
    on_two_hosts("train", "tabletop_organization", "--algo", "naive", *lengths, *out)
    on_two_hosts("resume", str(tmp_path / "two"), "--steps", "80")
    one = tmp_path / "one"
    earl_jax.train("tabletop_organization", "naive", seeds=4, steps=80, eval_every=40, out=one, **options)
    two, one = (RunFolder.open(path).rows() for path in (tmp_path / "two", one))
    assert [(row["step"], row["seed"]) for row in two] == [(row["step"], row["seed"]) for row in one]
    for ours, theirs in zip(two, one, strict=True):
        np.testing.assert_allclose([*ours.values()], [*theirs.values()], rtol=1e-4, atol=1e-5)
