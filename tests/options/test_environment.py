"""The cores of a process."""

import os

import pytest

from earl_jax.options import environment
from earl_jax.options.environment import core_count, own_cores


@pytest.mark.parametrize(("bound", "count", "cores"), [({5, 2}, 8, [2, 5]), (None, 3, [0, 1, 2]), (None, None, [0])])
def test_a_process_has_the_cores_it_is_bound_to_or_all_of_a_system_that_binds_none(monkeypatch, bound, count, cores):
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    if bound:
        monkeypatch.setattr(os, "sched_getaffinity", lambda process: bound, raising=False)
    else:
        monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert own_cores() == cores


@pytest.mark.parametrize(
    ("limit", "count"), [("300000 100000", 3), ("50000 100000", 1), ("900000 100000", 8), ("max 100000", 8), (None, 8)]
)
def test_a_container_can_limit_the_cores_that_a_process_may_keep_busy(monkeypatch, tmp_path, limit, count):
    file = tmp_path / "cpu.max"
    if limit:
        file.write_text(limit)
    monkeypatch.setattr(environment, "own_cores", lambda: list(range(8)))
    monkeypatch.setattr(environment, "CPU_LIMIT", file)
    assert core_count() == count
