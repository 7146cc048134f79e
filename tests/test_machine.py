"""The cores of a process."""

import os

import pytest

from earl_jax.machine import own_cores


def test_the_cores_of_a_process_are_those_it_is_bound_to(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {5, 2}, raising=False)
    assert own_cores() == [2, 5]


@pytest.mark.parametrize(("count", "cores"), [(3, [0, 1, 2]), (None, [0])])
def test_a_system_without_bound_cores_gives_all_of_them(monkeypatch, count, cores):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    assert own_cores() == cores
