"""The wall-clock limit of a command."""

import time

import numpy as np
import pytest

from earl_jax import InputError
from earl_jax.cli.arguments import parse_minutes
from earl_jax.time_limit import TimeLimit


def test_a_limit_counts_from_its_construction(monkeypatch):
    now = 1000.0
    monkeypatch.setattr(time, "time", lambda: now)
    limit = TimeLimit.of(0.5)
    assert limit.ends_at == 1030
    assert TimeLimit.of(limit) is limit
    assert TimeLimit.of(None) is None
    now = 1029.9
    assert not limit.passed
    now = 1030.0
    assert limit.passed


@pytest.mark.parametrize("minutes", [1, 0.5, np.float32(0.5), np.int64(3), 10**9])
def test_positive_numbers_are_accepted(minutes):
    assert TimeLimit.of(minutes).minutes == minutes


@pytest.mark.parametrize(
    "minutes", [0, -1, float("nan"), float("inf"), "soon", "5", True, [1], 10**400, np.array([1.0])]
)
def test_other_values_are_refused_with_the_valid_interval(minutes):
    with pytest.raises(InputError, match=r"minutes must lie in \(0, inf\), not "):
        TimeLimit.of(minutes)


def test_the_command_line_reads_numbers_and_shows_other_texts():
    assert parse_minutes("1e-3").minutes == 0.001
    assert parse_minutes(None) is None
    for text, shown in [("0", "0.0"), ("-2", "-2.0"), ("nan", "nan"), ("soon", "'soon'"), ("", "''")]:
        with pytest.raises(InputError, match=f"not {shown}$"):
            parse_minutes(text)


def test_a_limit_as_text_names_its_minutes():
    assert [str(TimeLimit.of(minutes)) for minutes in (1, 0.5, 90)] == ["1 minute", "0.5 minutes", "90 minutes"]
