"""The slots of workers: visible GPUs, an even share of cores and memory for each, and how many are measured to gain."""

import sys

import pytest

from benchmarks.output import RESULTS, read_csv
from earl_jax.sweeps import slots


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, ["0", "1"]),
        ({"CUDA_VISIBLE_DEVICES": "1, 0"}, ["1", "0"]),
        ({"CUDA_VISIBLE_DEVICES": "GPU-7,5,0"}, ["GPU-7"]),
        ({"CUDA_VISIBLE_DEVICES": "²,0"}, []),
        ({"CUDA_VISIBLE_DEVICES": "-1"}, []),
        ({"CUDA_VISIBLE_DEVICES": ""}, []),
        ({"JAX_PLATFORMS": "cpu"}, []),
        ({"JAX_PLATFORMS": "cuda, cpu"}, ["0", "1"]),
    ],
)
@pytest.mark.usefixtures("gpus")
def test_visible_gpus_are_those_that_cuda_and_jax_would_use(environment, expected):
    assert slots.visible_gpus(environment) == expected


def test_gpus_need_the_plugin_and_a_driver(gpus, monkeypatch, tmp_path):
    (gpus / "nvidia-smi").write_text("#!/bin/sh\necho 'NVIDIA-SMI has failed'; exit 9\n")
    assert slots.visible_gpus({"CUDA_VISIBLE_DEVICES": "GPU-7"}) == []
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    monkeypatch.setattr(slots, "NVIDIA_DRIVER", tmp_path / "gpus")
    assert slots.visible_gpus({}) == []
    (tmp_path / "gpus/0000:1").mkdir(parents=True)
    assert slots.visible_gpus({}) == ["0"], "the driver counts where nvidia-smi is missing"
    monkeypatch.setattr(slots, "cuda_plugin", lambda: None)
    assert slots.visible_gpus({}) == []


ONE = "1 program at a time on each of 2 GPUs, 4 cores each"
TWO = "2 programs at a time on each of 2 GPUs, 2 cores each through the"
STARTED = "start devices=\nquit\n"


@pytest.mark.parametrize(
    ("host", "per_device", "programs", "line", "log"),
    [
        ("broken MPS", 4, 4, f"{ONE}; MPS cannot be used: MPS is not supported here", "start devices=\n"),
        ("running MPS", 2, 4, f"{TWO} running MPS daemon", ""),
        ("GPUs", 3, 2, ONE, ""),
        ("GPUs", "auto", 4, ONE, ""),
        ("measured GPUs", "auto", 4, f"{TWO} MPS daemon started for them", STARTED),
        ("CPU", 2, 2, "2 programs at a time, 4 cores each", ""),
        ("CPU", "auto", 2, "1 program at a time, 8 cores each", ""),
    ],
)
def test_slots_depend_on_mps_and_on_the_number_of_programs(gpus, monkeypatch, host, per_device, programs, line, log):
    if host == "broken MPS":
        (gpus / "broken").touch()
    elif host == "running MPS":
        (gpus / "default").mkdir()
        (gpus / "default/nvidia-cuda-mps-control.pid").write_text("0")
    elif host == "CPU":
        monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    monkeypatch.setattr(slots, "GAINS", {"sawyer_door": {(2, 2): 1.8}} if host == "measured GPUs" else {})
    lines = []
    with slots.open_slots(per_device, ["sawyer_door"] * programs, lines.append) as opened:
        assert {bool(slot.variables) for slot in opened} == {log == STARTED}
    assert lines == [line]
    assert (gpus / "log").read_text() == log


def test_the_plugin_is_located_without_importing_it(tmp_path, monkeypatch):
    for name in list(sys.modules):
        if name.partition(".")[0] == "jax_plugins":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert slots.cuda_plugin() is None
    folder = tmp_path / "jax_plugins/xla_cuda12"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("raise RuntimeError")
    assert slots.cuda_plugin() == folder


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((2, ["0", "1"], range(9)), [("0", (0, 1)), ("1", (4, 5)), ("0", (2, 3)), ("1", (6, 7))]),
        ((3, [], [4, 6]), [(None, (4,)), (None, (6,)), (None, (4,))]),
    ],
)
def test_slots_share_cores_evenly_and_fill_every_gpu_first(arguments, expected):
    result = slots.make_slots(*arguments)
    assert [(slot.gpu, slot.cores) for slot in result] == expected
    assert {slot.per_device for slot in result} == {arguments[0]}


@pytest.mark.parametrize(
    ("slot", "inherited", "expected"),
    [
        (slots.Slot("1", (0,), 4), {}, {"JAX_PLATFORMS": "cuda,cpu", slots.FRACTION: "0.2300"}),
        (slots.Slot("1", (0,), 4), {"A": "b", slots.FRACTION: "0.5"}, {"A": "b", slots.FRACTION: "0.1250"}),
        (slots.Slot("1", (0,), 4), {slots.FRACTION: "0.95"}, {slots.FRACTION: "0.2300"}),
        (slots.Slot("1", (0,), 4), {slots.FRACTION: "x"}, {slots.FRACTION: "0.2300"}),
        (slots.Slot("1", (0,), 1), {slots.FRACTION: "0.95"}, {slots.FRACTION: "0.95"}),
        (slots.Slot("1", (0,), 1), {"JAX_PLATFORMS": "cuda"}, {"JAX_PLATFORMS": "cuda"}),
    ],
)
def test_programs_on_a_gpu_share_its_memory_and_keep_the_users_variables(slot, inherited, expected):
    environment = slot.environment(inherited)
    assert environment.items() >= {**expected, "CUDA_VISIBLE_DEVICES": "1"}.items()
    assert environment[slots.PER_DEVICE] == str(slot.per_device)
    assert slots.Slot(None, (0,), 2).environment({}) == {slots.PER_DEVICE: "2"}, "without a GPU"


def test_auto_takes_the_largest_gain_for_the_cores(monkeypatch):
    monkeypatch.setattr(slots, "GAINS", {"quick": {(2, 8): 1.8, (4, 4): 2.4}, "full": {(2, 8): 1.0}})
    programs = slots.measured_programs
    assert [programs(["quick"], cores) for cores in (32, 16, 15, 8)] == [4, 4, 1, 1]
    assert programs(["full"], 16) == 1, "two programs gain nothing"
    assert programs(["quick", "full"], 16) == programs(["quick", "unmeasured"], 16) == 1


def test_the_table_of_auto_is_the_committed_measurement():
    measured = {}
    for row in (row for path in RESULTS.glob("per_device/*.csv") for row in read_csv(path) if row["programs"] != "1"):
        key = int(row["programs"]), int(row["cores_each"])
        measured.setdefault(row["env"], {})[key] = float(row["wall_gain"])
    assert measured == slots.GAINS
