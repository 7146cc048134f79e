"""The cores of a process."""

import os

import pytest

from earl_jax.options.environment import own_cores


@pytest.mark.parametrize(("bound", "count", "cores"), [({5, 2}, 8, [2, 5]), (None, 3, [0, 1, 2]), (None, None, [0])])
def test_a_process_has_the_cores_it_is_bound_to_or_all_of_a_system_that_binds_none(monkeypatch, bound, count, cores):
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    if bound:
        monkeypatch.setattr(os, "sched_getaffinity", lambda process: bound, raising=False)
    else:
        monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert own_cores() == cores
