"""The rows of a replay on the host."""

import jax.numpy as jnp
import numpy as np
import pytest

from earl_jax.runs import snapshot


@pytest.mark.parametrize("rows", [100, 7])
def test_rows_are_copied_in_pieces_of_few_sizes(monkeypatch, rows):
    """jax keeps a program for each size, so that memory used to grow with every checkpoint."""
    expected, sizes = np.arange(300.0).reshape(100, 3), set()
    array = jnp.asarray(expected)
    monkeypatch.setattr(snapshot, "PIECE", rows * array.nbytes // len(array))
    monkeypatch.setattr(snapshot, "gathered", lambda piece: sizes.add(len(piece)) or np.asarray(piece))
    for count in range(102):
        for start, stop in ((0, count), (max(0, 100 - count), 100)):
            copied = snapshot._rows(array, start, stop, slice(1, 3))
            np.testing.assert_array_equal(copied, expected[start:stop, 1:3])
    assert max(sizes) <= rows
    assert len(sizes) <= 8
