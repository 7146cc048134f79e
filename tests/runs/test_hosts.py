"""Several hosts that run one program."""

import atexit
import contextlib
import signal
import time
from unittest.mock import Mock

import jax
import pytest
from jax.experimental import multihost_utils

import earl_jax
from earl_jax.cli.train import train
from earl_jax.errors import InputError
from earl_jax.runs.hosts import failing_at_once, join_hosts, require_same_on_hosts
from tests.cli.process import run, start_two, training


def test_hosts_take_auto_or_an_address_with_two_numbers(monkeypatch):
    join_hosts(None)
    for hosts in ("two", "here:1,²,0", "here,2,0", "here:1,2,2"):
        with pytest.raises(ValueError, match=f"--hosts takes auto or ADDRESS:PORT,HOSTS,NUMBER, .*, not '{hosts}'"):
            join_hosts(hosts)
    monkeypatch.setattr(jax.distributed, "initialize", Mock(side_effect=ValueError("no address")))
    with pytest.raises(InputError, match=r"--hosts auto: no cluster \(no address\); give ADDRESS:PORT,HOSTS,NUMBER"):
        join_hosts("auto")


def test_hosts_with_different_arguments_are_refused(monkeypatch):
    require_same_on_hosts("alone")
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    for other in (0, 1):
        monkeypatch.setattr(multihost_utils, "process_allgather", lambda own, tiled, other=other: [own, own + other])
        with pytest.raises(InputError, match="hosts have different arguments") if other else contextlib.nullcontext():
            require_same_on_hosts("alike", 1)


@pytest.mark.parametrize("call", [earl_jax.train, earl_jax.resume, train])
def test_a_host_that_fails_before_its_first_step_does_not_wait_for_the_others(call, monkeypatch):
    monkeypatch.setattr(jax.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(atexit, "register", Mock())
    with pytest.raises(InputError):
        call("nowhere")
    with pytest.raises(KeyboardInterrupt), failing_at_once():
        raise KeyboardInterrupt
    assert [registered.args[1] for registered in atexit.register.call_args_list] == [2, 130]
    monkeypatch.setattr(atexit, "unregister", Mock())
    with failing_at_once():
        pass
    atexit.unregister.assert_called_once_with(atexit.register.call_args.args[0])


@pytest.mark.slow
def test_a_host_that_dies_ends_the_other_one_and_costs_nothing(tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    outputs = [host.communicate(timeout=240) for host in start_two(*training(whole, "--steps", "400"))]
    assert (whole / "policies.npz").exists(), outputs
    first, second = start_two(*training(killed, "--steps", "400"))
    while not list(killed.glob("checkpoints/0*")) and second.poll() is None:
        time.sleep(0.01)
    second.kill()
    _, message = first.communicate(timeout=30)  # jax would wait for a minute, and abort
    assert first.returncode == 2, message
    assert "earl-jax: another host has ended" in message.splitlines()[-1]
    assert second.wait() == -signal.SIGKILL
    assert run("table", killed)[0] == 0
    assert (killed / "metrics.csv").read_bytes() != (whole / "metrics.csv").read_bytes()
    outputs = [host.communicate(timeout=240) for host in start_two("resume", killed)]
    assert (killed / "metrics.csv").read_bytes() == (whole / "metrics.csv").read_bytes(), outputs
