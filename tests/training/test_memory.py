"""The memory of a run: computed, printed, and refused before anything is written."""

import dataclasses
import warnings
from unittest.mock import Mock

import jax
import pytest

import earl_jax
from earl_jax.algos import make_algo
from earl_jax.envs import make
from earl_jax.runs.files import RunWarning
from earl_jax.training import memory
from tests.conftest import make_problem, make_train_state, tiny_method, tiny_train, write_files

CARD_BYTES = 141e9


@pytest.mark.parametrize(("name", "steps"), [("sawyer_peg", 5_900_000), ("dhand_lightbulb", 5_000_000)])
def test_a_hundred_lanes_of_the_published_length_fit_on_one_card(name, steps):
    """The longest published run, and the one with the largest observation."""
    need = memory.estimate(make_problem(make(name)), make_algo("r3l"), 100, steps)
    assert need.total < 0.95 * CARD_BYTES


def occupied(tree):
    """Return the bytes of all arrays of `tree`, which can be abstract."""
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))


@pytest.mark.parametrize("replay_capacity", [None, 50])
@pytest.mark.parametrize("algo", ["naive", "vaprl", "fbrl"])
def test_replay_and_agent_occupy_the_computed_bytes(problem, algo, replay_capacity):
    method, steps = tiny_method(algo, lanes=3, replay_capacity=replay_capacity), 300
    need = memory.estimate(problem, method, 3, steps)
    state = jax.eval_shape(lambda: make_train_state(problem, method, range(3), steps))
    assert abs(occupied(state.replay) - 3 * need.replay) < 250, "counts, and one more state than transitions"
    assert occupied(state.lanes) == 3 * need.agent
    longer = memory.estimate(problem, method, 3, 10 * steps)
    assert (longer == need) if replay_capacity else (longer.replay > need.replay)


def test_a_run_that_does_not_fit_is_refused_with_the_lanes_that_would_and_writes_nothing(monkeypatch, tmp_path):
    need = memory.estimate(make_problem(make("sawyer_door")), make_algo("naive"), 1, 80)
    monkeypatch.setattr(memory, "free_bytes", lambda device: 3 * need.lane + 1)
    with pytest.raises(ValueError, match=r"5 lanes take .* GB free: 3 lanes would fit.*XLA_PYTHON_CLIENT_MEM_FRACTION"):
        earl_jax.train("sawyer_door", "naive", seeds=5, steps=80, eval_every=80, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    memory.require(dataclasses.replace(need, lanes=3))
    assert str(need).startswith("1 lane takes ")
    assert str(need).endswith(" of work")


def test_a_disk_that_is_too_small_for_the_checkpoints_is_named(monkeypatch, tmp_path, problem):
    need = memory.estimate(problem, make_algo("naive"), 2, 80)
    size = 2 * (need.replay + need.agent)
    monkeypatch.setattr(memory.shutil, "disk_usage", Mock(return_value=Mock(free=3 * size)))
    with warnings.catch_warnings(action="error"):
        memory.warn_of_disk(need, tmp_path)
    memory.shutil.disk_usage.return_value.free -= 1
    with pytest.warns(RunWarning, match=f"the checkpoints of 2 lanes can need .* the disk of {tmp_path} has"):
        memory.warn_of_disk(need, tmp_path)
    (tmp_path / "checkpoints/000000040").mkdir(parents=True)
    memory.shutil.disk_usage.return_value.free = size
    with warnings.catch_warnings(action="error"):
        memory.warn_of_disk(need, tmp_path)
    memory.shutil.disk_usage.return_value.free = 0
    with pytest.warns(RunWarning, match=f"the disk of {tmp_path / 'run'} has 0 GB; training ends when it is full"):
        tiny_train("naive", out=tmp_path / "run")


def test_a_program_among_neighbours_is_refused_by_its_share_with_fewer_neighbours_as_the_remedy(monkeypatch):
    need = memory.MemoryEstimate(lanes=5, replay=10, agent=1, work=1)
    monkeypatch.setattr(memory, "free_bytes", lambda device: 59)
    monkeypatch.setenv(memory.PER_DEVICE, "4")
    with pytest.raises(ValueError, match=r"4 lanes would fit\. .* one of 4 programs; use --per-device 2 or"):
        memory.require(need)
    memory.require(dataclasses.replace(need, lanes=4))
    for platform, lanes in (("cpu", 8), ("gpu", 16)):  # CPU devices of a host share its memory
        mesh = Mock(local_devices=[Mock(platform=platform)] * 2, size=4)
        memory.require(dataclasses.replace(need, lanes=lanes), mesh)
        with pytest.raises(ValueError, match=f"4 devices have .* each free: {lanes} lanes would fit"):
            memory.require(dataclasses.replace(need, lanes=lanes + 4), mesh)


GROUPS = {
    "no limit": ("0::/job\n", {"memory.max": "max", "job/memory.max": "max"}, 8e9),
    "the job's": ("0::/job\n", {"memory.max": "max", "job/memory.max": f"{2 * 10**9}\n"}, 1.5e9),
    "its parent's": ("0::/job/step\n", {"job/memory.max": "2000000000", "job/step/memory.max": "max"}, 1.5e9),
    "version 1": ("4:memory:/job\n2:cpu:/\n0::/\n", {"memory/job/memory.limit_in_bytes": "2000000000"}, 1.5e9),
    "a container's": ("4:memory:/docker/1\n", {"memory/memory.limit_in_bytes": "2000000000"}, 1.5e9),
    "less than a process has": ("0::/\n", {"memory.max": "1000"}, 0),
    "more than the machine has": ("0::/\n", {"memory.max": str(10**12)}, 8e9),
    "no groups": (None, {}, 8e9),
}


@pytest.mark.parametrize("name", GROUPS)
def test_a_run_on_a_cpu_has_what_the_machine_and_its_control_groups_leave(name, monkeypatch, tmp_path):
    groups, files, free = GROUPS[name]
    files = {f"sys/{file}": text for file, text in files.items()} | ({"proc/self/cgroup": groups} if groups else {})
    files["proc/meminfo"] = f"MemTotal: {16 * 10**6} kB\nMemAvailable: {8 * 10**9 // 1024} kB\n"
    files["proc/self/status"] = f"RssAnon:\t {10**8 // 1024} kB\n"
    write_files(files, tmp_path)
    monkeypatch.setattr(memory, "PROC", tmp_path / "proc")
    monkeypatch.setattr(memory, "GROUPS", tmp_path / "sys")
    monkeypatch.setattr(memory, "RUNTIME", 4 * 10**8)
    assert memory.free_bytes(jax.devices("cpu")[0]) == pytest.approx(free, abs=2000)
    monkeypatch.setenv(memory.PER_DEVICE, "1000")
    assert memory.free_bytes(jax.devices("cpu")[0]) <= 16.4e6, "programs have equal shares of the machine"
